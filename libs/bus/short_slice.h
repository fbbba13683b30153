#pragma once

#include <cstdint>
#include <optional>

namespace splatbus::bus {

/// While it lives, the thread that made it, and each that this one starts, has a short slice of the processor. Whoever
/// carries messages works for moments: with a short slice its turn comes before those of threads that compute, and of
/// the processor it gets no more than its share. Linux 6.12 and later; elsewhere, and where a thread's scheduling is
/// somebody's choice already, nothing changes. docs/decisions/0132-short-slices.md says what it gives.
class ShortSlice {
 public:
  ShortSlice();
  ~ShortSlice();
  ShortSlice(const ShortSlice&) = delete;
  ShortSlice& operator=(const ShortSlice&) = delete;

  /// Long enough for most messages, and for a thread that does compute once in a while not to be switched all the time.
  static constexpr std::uint64_t kSlice_ns = 500'000;

 private:
  std::optional<std::uint64_t> before_ns_;
};

/// Of a thread of this process, by its number in /proc/self/task, or 0 for the caller: its slice, 0 where the kernel
/// knows of none; nullopt where it cannot be read or is no thread of the default policy.
[[nodiscard]] std::optional<std::uint64_t> slice_ns(int thread);

}  // namespace splatbus::bus
