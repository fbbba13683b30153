#include "bus/memory.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <new>

#include "bus/error.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "bus/gpu/device_memory.h"
#endif

namespace splatbus::bus {
namespace {

constexpr std::size_t kAlignment = 64;

#ifndef SPLATBUS_HAVE_CUDA
[[noreturn]] void no_device() {
  throw Error("this build has no CUDA memory");
}
#endif

}  // namespace

std::shared_ptr<std::byte> allocate_memory(Device kind, std::size_t bytes) {
  bytes = std::max<std::size_t>(bytes, 1);
  if (kind == Device::Cpu) {
    auto* const memory = static_cast<std::byte*>(::operator new(bytes, std::align_val_t(kAlignment)));
    std::memset(memory, 0, bytes);
    return {memory, [](std::byte* owned) { ::operator delete(owned, std::align_val_t(kAlignment)); }};
  }
#ifdef SPLATBUS_HAVE_CUDA
  return gpu::allocate(bytes);
#else
  no_device();
#endif
}

std::size_t free_memory(Device kind) {
  if (kind == Device::Cpu) return std::numeric_limits<std::size_t>::max();
#ifdef SPLATBUS_HAVE_CUDA
  return gpu::free_bytes();
#else
  no_device();
#endif
}

void copy_memory(void* destination, Device to, const void* source, Device from, std::size_t bytes) {
  if (bytes == 0) return;
  if (to == Device::Cpu && from == Device::Cpu) {
    std::memcpy(destination, source, bytes);
    return;
  }
#ifdef SPLATBUS_HAVE_CUDA
  gpu::enqueue_copy(destination, source, bytes);
#else
  no_device();
#endif
}

void finish_copies() {
#ifdef SPLATBUS_HAVE_CUDA
  gpu::finish_copies();
#endif
}

void require_usable([[maybe_unused]] Device kind) {
#ifdef SPLATBUS_HAVE_CUDA
  if (kind == Device::Cuda) gpu::require_usable();
#endif
}

bool copy_tensor(const TensorView& tensor, void* destination, Device kind, std::atomic<std::uint64_t>& host_bytes) {
  if (!tensor.still_valid()) return false;
  copy_memory(destination, kind, tensor.data(), tensor.memory(), tensor.bytes());
  finish_copies();
  if (kind == Device::Cpu || tensor.memory() == Device::Cpu) host_bytes += tensor.bytes();
  return tensor.still_valid();
}

}  // namespace splatbus::bus
