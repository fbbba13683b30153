#pragma once

#include "raster/torch/tensor.h"

namespace splatbus::raster {

/// Throws c10::Error that names `operation` and `name` unless the tensor is a contiguous one of that type, shape and
/// device.
inline void check_tensor(const torch::Tensor& tensor, const char* operation, const char* name, at::ScalarType type,
                         at::IntArrayRef shape, const at::Device& device) {
  TORCH_CHECK(tensor.defined(), operation, ": ", name, " is undefined");
  TORCH_CHECK(tensor.scalar_type() == type, operation, ": ", name, " is ", tensor.scalar_type(), ", ", type,
              " is needed");
  TORCH_CHECK(tensor.device() == device, operation, ": ", name, " is on ", tensor.device(), ", the others are on ",
              device);
  TORCH_CHECK(tensor.sizes() == shape, operation, ": ", name, " is ", tensor.sizes(), ", ", shape, " is needed");
  TORCH_CHECK(tensor.layout() == at::kStrided && tensor.is_contiguous(), operation, ": ", name,
              " is not contiguous; contiguous() makes a copy that is");
}

}  // namespace splatbus::raster
