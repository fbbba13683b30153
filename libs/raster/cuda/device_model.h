#pragma once

#include <cuda_runtime_api.h>

#include <cstdint>

#include "device/buffer.h"
#include "device/check.h"
#include "gaussians/model.h"
#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

/// A model copied to the device.
class DeviceModel {
 public:
  /// Copies every plane that `host` has; the copies' stride is the count.
  void upload(const GaussiansView& host, cudaStream_t stream);
  /// Copies the parameters back, [channels][count].
  void download_parameters(float* host, cudaStream_t stream) const;
  [[nodiscard]] const DeviceGaussians& view() const { return view_; }

 private:
  DeviceGaussians view_;
  device::Buffer<float> parameters_, normal_, visibility_;
  device::Buffer<std::uint32_t> object_id_, flags_;
};

}  // namespace splatbus::raster::cuda
