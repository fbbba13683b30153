#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "device/buffer.h"
#include "device/check.h"
#include "gaussians/model.h"
#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

/// Ranges and bounds of a model in pages, copied to the device.
class DeviceRanges {
 public:
  void upload(const GaussiansView& host, cudaStream_t stream);
  /// Points `gaussians` at them.
  void bind(DeviceGaussians& gaussians) const;

 private:
  device::Buffer<IndexRange> ranges_;
  device::Buffer<PageBounds> bounds_;
};

/// The addresses of a view of device memory, but for ranges and bounds.
[[nodiscard]] DeviceGaussians device_gaussians(const GaussiansView& view);

/// A model copied to the device.
class DeviceModel {
 public:
  /// Copies every plane that `host` has. The copies' stride is the count; a model in pages stays in them.
  void upload(const GaussiansView& host, cudaStream_t stream);
  /// Copies the parameters back, [channels][count], or [pages][channels][kPageLanes].
  void download_parameters(float* host, cudaStream_t stream) const;
  [[nodiscard]] const DeviceGaussians& view() const { return view_; }

 private:
  void upload_planes(const GaussiansView& host, cudaStream_t stream);
  void upload_pages(const GaussiansView& host, cudaStream_t stream);

  DeviceGaussians view_;
  device::Buffer<float> parameters_, normal_, visibility_;
  device::Buffer<std::uint8_t> visibility_u8_;
  device::Buffer<std::uint32_t> object_id_, flags_;
  DeviceRanges ranges_;
};

}  // namespace splatbus::raster::cuda
