#include "sim/cuda/gl_interop.h"  // brings epoxy's gl.h, which has to come before that of the interop header

#include <cuda_gl_interop.h>
#include <cuda_runtime_api.h>

#include <algorithm>
#include <array>
#include <span>
#include <utility>

#include "device/check.h"

namespace splatbus::sim::cuda {

using device::check;

bool renders_on_first_device() {
  constexpr unsigned kMostDevices = 16;
  std::array<int, kMostDevices> devices{};
  unsigned count = 0;
  if (cudaGLGetDevices(&count, devices.data(), kMostDevices, cudaGLDeviceListAll) != cudaSuccess) {
    static_cast<void>(cudaGetLastError());  // the next call shall not find it
    return false;
  }
  const std::span found(devices.data(), std::min(count, kMostDevices));
  return std::ranges::find(found, 0) != found.end();
}

GlInterop::~GlInterop() {
  if (mapped_) cudaGraphicsUnmapResources(static_cast<int>(taken_.size()), taken_.data(), cudaStreamPerThread);
  for (auto& [buffer, pixels] : buffers_) {
    if (pixels.resource != nullptr) cudaGraphicsUnregisterResource(pixels.resource);
  }
}

void GlInterop::begin(std::uint32_t /*width*/, std::uint32_t /*height*/) {
  unmap();
  taken_.clear();
  images_.clear();
}

void GlInterop::take(const DrawnPicture& drawn) {
  PixelBuffer& pixels = buffers_[drawn.buffer];
  if (pixels.bytes < drawn.bytes) grow(pixels, drawn.bytes);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, pixels.name.get());
  read_pixels(drawn, nullptr);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  taken_.push_back(pixels.resource);
  images_.push_back({.buffer = static_cast<std::uint32_t>(drawn.buffer),
                     .data = nullptr,
                     .bytes = drawn.bytes,
                     .memory = SPLATBUS_MEMORY_CUDA});
}

const std::vector<splatbus_image>& GlInterop::images() {
  if (mapped_ || taken_.empty()) return images_;
  check(cudaGraphicsMapResources(static_cast<int>(taken_.size()), taken_.data(), cudaStreamPerThread),
        "mapping pictures of OpenGL");
  mapped_ = true;
  for (std::size_t i = 0; i < taken_.size(); ++i) {
    void* data = nullptr;
    std::size_t bytes = 0;
    check(cudaGraphicsResourceGetMappedPointer(&data, &bytes, taken_[i]), "finding a picture of OpenGL");
    images_[i].data = data;
  }
  // The mapping waits for OpenGL in the stream, and this for the stream.
  check(cudaStreamSynchronize(cudaStreamPerThread), "waiting for OpenGL");
  return images_;
}

void GlInterop::grow(PixelBuffer& buffer, std::size_t bytes) {
  if (buffer.resource != nullptr) {
    check(cudaGraphicsUnregisterResource(std::exchange(buffer.resource, nullptr)), "giving back a pixel buffer");
  }
  buffer.bytes = 0;
  buffer.name = make_buffer();
  // No flags: nobody but the device writes or reads it.
  glNamedBufferStorage(buffer.name.get(), static_cast<GLsizeiptr>(bytes), nullptr, 0);
  check(cudaGraphicsGLRegisterBuffer(&buffer.resource, buffer.name.get(), cudaGraphicsRegisterFlagsReadOnly),
        "registering a pixel buffer");
  buffer.bytes = bytes;
}

void GlInterop::unmap() {
  if (!std::exchange(mapped_, false)) return;
  check(cudaGraphicsUnmapResources(static_cast<int>(taken_.size()), taken_.data(), cudaStreamPerThread),
        "handing pictures back to OpenGL");
}

}  // namespace splatbus::sim::cuda
