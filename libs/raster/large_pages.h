#pragma once

#include <sys/mman.h>

#include <cstddef>
#include <cstdlib>
#include <new>

namespace splatbus::raster {

/// Memory for big arrays that are walked plane by plane: from 2 MiB on it begins at a large page and asks for such
/// pages, of which a core finds the addresses without a walk; below, one cache line. free() gives it back.
[[nodiscard]] inline void* allocate_large(std::size_t bytes) {
  constexpr std::size_t kLargePage = std::size_t{2} << 20U, kCacheLine = 64;
  const std::size_t unit = bytes >= kLargePage ? kLargePage : kCacheLine;
  const std::size_t room = (bytes + unit - 1) / unit * unit;
  void* memory = std::aligned_alloc(unit, room);
  if (memory == nullptr && room > 0) throw std::bad_alloc();
  if (unit == kLargePage) (void)::madvise(memory, room, MADV_HUGEPAGE);  // a wish: without it all is as correct
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

}  // namespace splatbus::raster
