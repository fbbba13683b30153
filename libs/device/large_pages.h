#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>
#include <new>

namespace splatbus::device {

/// Memory for big arrays: from one large page on it begins at such a page and asks for them, so that planes walked side
/// by side need no walk for their addresses; below, it begins at a cache line. std::free() gives it back.
[[nodiscard]] inline void* allocate_large(std::size_t bytes) {
  constexpr std::size_t kLargePage = std::size_t{2} << 20U, kCacheLine = 64;
  const std::size_t unit = bytes >= kLargePage ? kLargePage : kCacheLine;
  const std::size_t room = (bytes + unit - 1) / unit * unit;
  void* memory = std::aligned_alloc(unit, room);
  if (memory == nullptr && room > 0) throw std::bad_alloc();
  if (unit == kLargePage) (void)::madvise(memory, room, MADV_HUGEPAGE);  // a wish: only time depends on it
  return memory;
}

/// The same for containers.
template <class T>
struct LargePageAllocator {
  using value_type = T;
  LargePageAllocator() = default;
  template <class U>
  LargePageAllocator(const LargePageAllocator<U>&) {}  // NOLINT(google-explicit-constructor): allocators convert
  [[nodiscard]] T* allocate(std::size_t count) { return static_cast<T*>(allocate_large(count * sizeof(T))); }
  void deallocate(T* memory, std::size_t) { std::free(memory); }
  template <class U>
  bool operator==(const LargePageAllocator<U>&) const {
    return true;
  }
};

}  // namespace splatbus::device
