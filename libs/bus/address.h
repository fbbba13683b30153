#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace splatbus::bus {

/// Where a bus is. `ipc:///some/dir`: a folder that holds the broker's sockets (xsub, xpub, slabs) and its lock file.
/// `tcp://host:port`: the broker's XSUB is at port, its XPUB at port + 1, and there are no slabs: tensors ride inline.
struct Address {
  /// Throws Error that names the text and what is wrong with it.
  static Address parse(const std::string& text);
  /// SPLATBUS_BUS when set, else ipc:///run/user/<uid>/splatbus or ipc:///tmp/splatbus-<uid>.
  static Address from_environment();

  [[nodiscard]] bool is_local() const { return directory.has_value(); }
  [[nodiscard]] std::string publish_endpoint() const;    ///< publishers connect here (the broker's XSUB)
  [[nodiscard]] std::string subscribe_endpoint() const;  ///< subscribers connect here (the broker's XPUB)
  [[nodiscard]] std::string slab_socket() const;         ///< path; local only
  [[nodiscard]] std::string text() const;

  std::optional<std::string> directory;
  std::string host;
  std::uint16_t port = 0;
  std::string key_file, server_key;  ///< over tcp: bus::client_keys() says what they are, and when they may be empty
};

}  // namespace splatbus::bus
