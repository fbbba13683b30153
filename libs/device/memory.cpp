#include "device/memory.h"

#include <cstdlib>
#include <cstring>
#include <stdexcept>

#include "device/large_pages.h"
#ifdef SPLATBUS_HAVE_CUDA
#include <cuda_runtime_api.h>

#include "device/check.h"
#endif

namespace splatbus::device {

#ifndef SPLATBUS_HAVE_CUDA

namespace {

[[noreturn]] void fail_without_cuda() {
  throw std::runtime_error("this build has no CUDA");
}

}  // namespace

#endif

void StreamView::wait() const {
#ifdef SPLATBUS_HAVE_CUDA
  if (on_cuda()) check(cudaStreamSynchronize(cuda), "waiting for a stream");
#endif
}

StreamView thread_stream(Device device) {
#ifdef SPLATBUS_HAVE_CUDA
  if (device == Device::Cuda) return {.device = device, .cuda = cudaStreamPerThread};
#endif
  return {.device = device};
}

Stream::Stream(Device device) : view_{.device = device} {
  if (device == Device::Cpu) return;
#ifdef SPLATBUS_HAVE_CUDA
  check(cudaStreamCreateWithFlags(&view_.cuda, cudaStreamNonBlocking), "creating a stream");
#else
  fail_without_cuda();
#endif
}

#ifndef SPLATBUS_HAVE_CUDA

Stream::~Stream() = default;

#else

Stream::~Stream() {
  if (view_.cuda != nullptr) cudaStreamDestroy(view_.cuda);
}

namespace {

/// What a stream gives back stays with the process: given to the device at each wait, it would be asked for again at
/// once.
void keep_freed_memory() {
  static const bool kept = [] {
    int device = 0;
    check(cudaGetDevice(&device), "asking for the device");
    cudaMemPool_t pool = nullptr;
    check(cudaDeviceGetDefaultMemPool(&pool, device), "asking for the memory pool");
    std::uint64_t everything = UINT64_MAX;
    check(cudaMemPoolSetAttribute(pool, cudaMemPoolAttrReleaseThreshold, &everything), "setting up the memory pool");
    return true;
  }();
  static_cast<void>(kept);
}

void* allocate_cuda(StreamView stream, std::size_t bytes) {
  void* memory = nullptr;
  if (stream.cuda == nullptr) {
    check_allocation(cudaMalloc(&memory, bytes), "allocating a buffer", bytes);
  } else {
    keep_freed_memory();
    check_allocation(cudaMallocAsync(&memory, bytes, stream.cuda), "allocating a buffer", bytes);
  }
  return memory;
}

}  // namespace

#endif

void* allocate(StreamView stream, std::size_t bytes) {
  if (bytes == 0) return nullptr;
  if (!stream.on_cuda()) return allocate_large(bytes);
#ifdef SPLATBUS_HAVE_CUDA
  return allocate_cuda(stream, bytes);
#else
  fail_without_cuda();
#endif
}

void deallocate(StreamView stream, void* memory) noexcept {
  if (memory == nullptr) return;
  if (!stream.on_cuda()) {
    std::free(memory);
    return;
  }
#ifdef SPLATBUS_HAVE_CUDA
  if (stream.cuda == nullptr) {
    cudaFree(memory);
  } else {
    cudaFreeAsync(memory, stream.cuda);
  }
#endif
}

void copy(StreamView stream, void* destination, const void* source, std::size_t bytes) {
  if (bytes == 0) return;
  if (!stream.on_cuda()) {
    std::memcpy(destination, source, bytes);
    return;
  }
#ifdef SPLATBUS_HAVE_CUDA
  check(cudaMemcpyAsync(destination, source, bytes, cudaMemcpyDefault, stream.cuda), "copying");
#else
  fail_without_cuda();
#endif
}

void fill(StreamView stream, void* memory, int value, std::size_t bytes) {
  if (bytes == 0) return;
  if (!stream.on_cuda()) {
    std::memset(memory, value, bytes);
    return;
  }
#ifdef SPLATBUS_HAVE_CUDA
  check(cudaMemsetAsync(memory, value, bytes, stream.cuda), "filling memory");
#else
  fail_without_cuda();
#endif
}

}  // namespace splatbus::device
