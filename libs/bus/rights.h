#pragma once

#include <optional>
#include <string>
#include <string_view>

namespace splatbus::bus {

/// What a peer may do. Of a connection over ipc or over plaintext tcp on the loopback address: everything; of one with
/// a key: what the allow-list says of that key now.
struct Rights {
  bool view = false;     ///< follow a stream; read a bus
  bool steer = false;    ///< have the engine's cameras follow its pose
  bool probe = false;    ///< ask the engine for pictures
  bool control = false;  ///< publish on a bus, set parameters

  [[nodiscard]] static constexpr Rights all() { return {.view = true, .steer = true, .probe = true, .control = true}; }
  [[nodiscard]] constexpr bool any() const { return view || steer || probe || control; }
  /// True where everything that `needed` names is here too.
  [[nodiscard]] constexpr bool include(const Rights& needed) const {
    return (view || !needed.view) && (steer || !needed.steer) && (probe || !needed.probe) &&
           (control || !needed.control);
  }
  friend constexpr bool operator==(const Rights&, const Rights&) = default;
};

/// "view,probe"; empty for none.
[[nodiscard]] std::string to_text(const Rights& rights);

/// From names with commas between them; nullopt when one of them does not exist.
[[nodiscard]] std::optional<Rights> parse_rights(std::string_view text);

}  // namespace splatbus::bus
