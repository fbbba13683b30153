#pragma once

#include <linux/tcp.h>

#include <cstdint>
#include <optional>
#include <string>

#include "bus/file_descriptor.h"

namespace splatbus::bus {

/// A descriptor of our own of a tcp connection of libzmq's, which may close its own at any time: what is done by this
/// one is never done to another connection that has got the number. The peer sees the end when both are closed.
class HeldConnection {
 public:
  /// Invalid where `fd` is none any more, or no descriptor is left.
  static HeldConnection of(int fd);
  /// Whether that number is one of ours, in this process: then libzmq has none of that number.
  static bool has(int fd);

  HeldConnection() = default;
  ~HeldConnection() { close(); }
  HeldConnection(HeldConnection&&) noexcept = default;
  HeldConnection& operator=(HeldConnection&& other) noexcept;
  HeldConnection(const HeldConnection&) = delete;
  HeldConnection& operator=(const HeldConnection&) = delete;

  [[nodiscard]] bool valid() const { return fd_.valid(); }
  /// peer_socket.h's.
  [[nodiscard]] std::uint64_t cookie() const;
  [[nodiscard]] std::optional<tcp_info> info() const;
  /// Of what it inherits where it was accepted while a Door was being shut.
  void detach_filter() const;
  /// No more of either direction, and a reset instead of what was still to be sent.
  void shut() const { shut(fd_.get()); }
  static void shut(int fd);

 private:
  explicit HeldConnection(FileDescriptor fd) : fd_(std::move(fd)) {}
  void close();

  FileDescriptor fd_;
};

/// Of a tcp connection's peer; empty for what is none.
[[nodiscard]] std::string address_of(int fd);

}  // namespace splatbus::bus
