#pragma once

#include <vector>

#include "sim/device_readback.h"

// As in the CUDA runtime's headers, which only the implementation needs.
struct cudaGraphicsResource;

namespace splatbus::sim::cuda {

/// Whether the current OpenGL context renders on the first CUDA device.
[[nodiscard]] bool renders_on_first_device();

/// Reads pictures into pixel buffer objects that CUDA maps: OpenGL converts and lays them out as for the host, and they
/// never leave the device. One buffer for each camera that is read before the next finish(), registered once and again
/// only when it grows: to map one takes the driver as long whatever is in it.
class GlInterop final : public DeviceReadback {
 public:
  GlInterop() = default;
  ~GlInterop() override;
  GlInterop(const GlInterop&) = delete;
  GlInterop& operator=(const GlInterop&) = delete;

  void begin(std::uint32_t width, std::uint32_t height, std::size_t bytes) override;
  void take(const DrawnPicture& drawn) override;
  [[nodiscard]] const std::vector<std::vector<splatbus_image>>& finish() override;
  void keep(std::size_t cameras) override;

 private:
  struct PixelBuffer {
    GlBuffer name;
    std::size_t bytes = 0;
    cudaGraphicsResource* resource = nullptr;
  };
  static void grow(PixelBuffer& buffer, std::size_t bytes);
  void unmap();

  std::vector<PixelBuffer> buffers_;  ///< by camera since the last finish()
  std::vector<std::vector<splatbus_image>> images_;
  std::vector<cudaGraphicsResource*> mapped_;
  bool finished_ = false;
};

}  // namespace splatbus::sim::cuda
