#include "bus/gpu/device_memory.h"

#include <cuda_runtime_api.h>
#include <fmt/format.h>

#include "bus/error.h"
#include "bus/gpu/cuda_driver.h"

namespace splatbus::bus::gpu {
namespace {

thread_local bool copies_enqueued =
    false;  // NOLINT(cppcoreguidelines-avoid-non-const-global-variables): a stream is a thread's

void check(cudaError_t status, const char* what) {
  if (status == cudaSuccess) return;
  static_cast<void>(cudaGetLastError());  // else this thread's next launch is blamed for it
  throw Error(fmt::format("CUDA: {}: {}", what, cudaGetErrorString(status)));
}

}  // namespace

std::shared_ptr<std::byte> allocate(std::size_t bytes) {
  (void)Driver::get();  // throws when there is no device
  void* memory = nullptr;
  check(cudaMalloc(&memory, bytes), fmt::format("allocating {} bytes", bytes).c_str());
  std::shared_ptr<std::byte> owner(static_cast<std::byte*>(memory), [](std::byte* owned) { cudaFree(owned); });
  check(cudaMemsetAsync(memory, 0, bytes, cudaStreamPerThread), "clearing memory");
  check(cudaStreamSynchronize(cudaStreamPerThread), "clearing memory");
  return owner;
}

std::size_t free_bytes() {
  (void)Driver::get();  // throws when there is no device
  std::size_t free = 0;
  std::size_t total = 0;
  check(cudaMemGetInfo(&free, &total), "asking for free memory");
  return free;
}

void enqueue_copy(void* destination, const void* source, std::size_t bytes) {
  // The thread's own stream waits for no kernels of others.
  check(cudaMemcpyAsync(destination, source, bytes, cudaMemcpyDefault, cudaStreamPerThread), "copying");
  copies_enqueued = true;
}

void finish_copies() {
  if (!copies_enqueued) return;  // a process that never asked for a device need not have one
  copies_enqueued = false;
  check(cudaStreamSynchronize(cudaStreamPerThread), "waiting for copies");
}

void require_usable() {
  static_cast<void>(cudaGetLastError());  // what a failed allocation leaves behind
  check(cudaStreamSynchronize(cudaStreamPerThread), "the device does no more work for this process");
}

}  // namespace splatbus::bus::gpu
