#pragma once

#include <vector>

namespace splatbus::bus {

/// Whether the kernel takes new connections to listening tcp sockets. Whoever connects while it takes none tries again
/// by itself (after a second, at first), as where a packet was lost. Not locked.
class Door {
 public:
  /// `listener` is a descriptor that somebody else owns.
  void add(int listener);
  void set_open(bool open);
  [[nodiscard]] bool open() const { return open_; }

 private:
  void apply(int listener) const;

  std::vector<int> listeners_;
  bool open_ = true;
};

}  // namespace splatbus::bus
