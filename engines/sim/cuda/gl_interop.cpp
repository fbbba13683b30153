#include "sim/cuda/gl_interop.h"  // brings epoxy's gl.h, which has to come before that of the interop header

#include <cuda_gl_interop.h>
#include <cuda_runtime_api.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cstddef>
#include <span>
#include <utility>

#include "device/check.h"

namespace splatbus::sim::cuda {

using device::check;

namespace {

constexpr std::size_t kAlignment = 16, kMostBuffers = 7;

std::size_t aligned(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

/// In its camera's buffer, until that is mapped.
std::size_t offset_of(const splatbus_image& image) {
  return reinterpret_cast<std::uintptr_t>(image.data);
}

}  // namespace

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
  for (const PixelBuffer& pixels : buffers_) {
    if (pixels.resource != nullptr) cudaGraphicsUnregisterResource(pixels.resource);
  }
}

void GlInterop::begin(std::uint32_t /*width*/, std::uint32_t /*height*/, std::size_t bytes) {
  unmap();
  if (std::exchange(finished_, false)) images_.clear();
  images_.emplace_back();
  if (buffers_.size() < images_.size()) buffers_.emplace_back();
  PixelBuffer& pixels = buffers_[images_.size() - 1];
  const std::size_t room = bytes + kMostBuffers * kAlignment;
  if (pixels.bytes < room) grow(pixels, room);
}

void GlInterop::take(const DrawnPicture& drawn) {
  const PixelBuffer& pixels = buffers_.at(images_.size() - 1);
  const std::vector<splatbus_image>& before = images_.back();
  const std::size_t offset = before.empty() ? 0 : aligned(offset_of(before.back()) + before.back().bytes);
  assert(offset + drawn.bytes <= pixels.bytes);
  auto* const at = reinterpret_cast<void*>(offset);  // NOLINT(performance-no-int-to-ptr): into the bound buffer
  glBindBuffer(GL_PIXEL_PACK_BUFFER, pixels.name.get());
  read_pixels(drawn, at);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  images_.back().push_back({.buffer = static_cast<std::uint32_t>(drawn.buffer),
                            .data = at,
                            .bytes = drawn.bytes,
                            .memory = SPLATBUS_MEMORY_CUDA});
}

void GlInterop::keep(std::size_t cameras) {
  if (!finished_ && images_.size() > cameras) images_.resize(cameras);
}

const std::vector<std::vector<splatbus_image>>& GlInterop::finish() {
  if (std::exchange(finished_, true)) return images_;
  std::vector<cudaGraphicsResource*> all;
  for (std::size_t camera = 0; camera < images_.size(); ++camera) {
    if (!images_[camera].empty()) all.push_back(buffers_[camera].resource);
  }
  if (all.empty()) return images_;
  check(cudaGraphicsMapResources(static_cast<int>(all.size()), all.data(), cudaStreamPerThread),
        "mapping pictures of OpenGL");
  mapped_ = std::move(all);
  for (std::size_t camera = 0; camera < images_.size(); ++camera) {
    if (images_[camera].empty()) continue;
    void* data = nullptr;
    std::size_t bytes = 0;
    check(cudaGraphicsResourceGetMappedPointer(&data, &bytes, buffers_[camera].resource),
          "finding a picture of OpenGL");
    for (splatbus_image& image : images_[camera]) image.data = static_cast<std::byte*>(data) + offset_of(image);
  }
  // The mapping waits for OpenGL in the stream, and this for the stream.
  check(cudaStreamSynchronize(cudaStreamPerThread), "waiting for OpenGL");
  return images_;
}

void GlInterop::grow(PixelBuffer& buffer, std::size_t bytes) {
  buffer.bytes = 0;
  if (buffer.resource != nullptr) {
    check(cudaGraphicsUnregisterResource(std::exchange(buffer.resource, nullptr)), "giving back a pixel buffer");
  }
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
