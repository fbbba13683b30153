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
  if (!mapped_.empty())
    cudaGraphicsUnmapResources(static_cast<int>(mapped_.size()), mapped_.data(), cudaStreamPerThread);
  for (auto& camera : buffers_) {
    for (auto& [buffer, pixels] : camera) {
      if (pixels.resource != nullptr) cudaGraphicsUnregisterResource(pixels.resource);
    }
  }
}

void GlInterop::begin(std::uint32_t /*width*/, std::uint32_t /*height*/) {
  unmap();
  if (std::exchange(finished_, false)) {
    taken_.clear();
    images_.clear();
  }
  taken_.emplace_back();
  images_.emplace_back();
  if (buffers_.size() < images_.size()) buffers_.emplace_back();
}

void GlInterop::take(const DrawnPicture& drawn) {
  PixelBuffer& pixels = buffers_.at(images_.size() - 1)[drawn.buffer];
  if (pixels.bytes < drawn.bytes) grow(pixels, drawn.bytes);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, pixels.name.get());
  read_pixels(drawn, nullptr);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  taken_.back().push_back(pixels.resource);
  images_.back().push_back({.buffer = static_cast<std::uint32_t>(drawn.buffer),
                            .data = nullptr,
                            .bytes = drawn.bytes,
                            .memory = SPLATBUS_MEMORY_CUDA});
}

void GlInterop::keep(std::size_t cameras) {
  if (finished_ || images_.size() <= cameras) return;
  taken_.resize(cameras);
  images_.resize(cameras);
}

const std::vector<std::vector<splatbus_image>>& GlInterop::finish() {
  if (std::exchange(finished_, true)) return images_;
  std::vector<cudaGraphicsResource*> all;
  for (const auto& camera : taken_) all.insert(all.end(), camera.begin(), camera.end());
  if (all.empty()) return images_;
  check(cudaGraphicsMapResources(static_cast<int>(all.size()), all.data(), cudaStreamPerThread),
        "mapping pictures of OpenGL");
  mapped_ = std::move(all);
  for (std::size_t camera = 0; camera < images_.size(); ++camera) {
    for (std::size_t i = 0; i < images_[camera].size(); ++i) {
      void* data = nullptr;
      std::size_t bytes = 0;
      check(cudaGraphicsResourceGetMappedPointer(&data, &bytes, taken_[camera][i]), "finding a picture of OpenGL");
      images_[camera][i].data = data;
    }
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
  if (mapped_.empty()) return;
  std::vector<cudaGraphicsResource*> resources = std::exchange(mapped_, {});
  check(cudaGraphicsUnmapResources(static_cast<int>(resources.size()), resources.data(), cudaStreamPerThread),
        "handing pictures back to OpenGL");
}

}  // namespace splatbus::sim::cuda
