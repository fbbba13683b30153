#pragma once

#include <cstdint>
#include <vector>

namespace splatbus::bus {

/// Whether the kernel takes new connections to listening tcp sockets. Whoever connects while it takes none tries again
/// by itself (after a second, at first), as where a packet was lost. Not locked.
class Door {
 public:
  /// `listener` is a descriptor that somebody else owns; other sockets than tcp's are left alone.
  void add(int listener);
  void set_open(bool open);
  [[nodiscard]] bool open() const { return open_; }

 private:
  struct Listener {
    int fd = -1;
    std::uint64_t cookie = 0;
  };
  void apply(const Listener& listener) const;

  std::vector<Listener> listeners_;
  bool open_ = true;
};

}  // namespace splatbus::bus
