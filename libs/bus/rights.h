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
  /// What both have.
  friend constexpr Rights operator&(const Rights& a, const Rights& b) {
    return {.view = a.view && b.view,
            .steer = a.steer && b.steer,
            .probe = a.probe && b.probe,
            .control = a.control && b.control};
  }
  friend constexpr bool operator==(const Rights&, const Rights&) = default;
};

/// "view,probe"; empty for none.
[[nodiscard]] std::string to_text(const Rights& rights);

/// From names with commas between them; nullopt when one of them does not exist.
[[nodiscard]] std::optional<Rights> parse_rights(std::string_view text);

/// The frame that a relay puts in front of a message of one of its own clients: what that one may do. It only takes
/// rights away from the relay's own, so nobody has to be trusted with it.
[[nodiscard]] std::string rights_frame(const Rights& rights);

/// Nullopt where the frame is none: it is the message's own first one.
[[nodiscard]] std::optional<Rights> parse_rights_frame(std::string_view frame);

}  // namespace splatbus::bus
