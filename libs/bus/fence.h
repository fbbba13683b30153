#pragma once

#include <atomic>

namespace splatbus::bus {

#if defined(__SANITIZE_THREAD__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wtsan"  // ThreadSanitizer does not model fences; what they order crosses processes
#endif

inline void acquire_fence() {
  std::atomic_thread_fence(std::memory_order_acquire);
}
inline void release_fence() {
  std::atomic_thread_fence(std::memory_order_release);
}

#if defined(__SANITIZE_THREAD__)
#pragma GCC diagnostic pop
#endif

}  // namespace splatbus::bus
