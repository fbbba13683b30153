#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <string>
#include <type_traits>

#include "raster/torch/tensor.h"

namespace splatbus::raster {

/// A part of an error's words. Numbers do not go through a stream, as c10::str() would take them: in a Python whose
/// PyTorch brings parts of another libstdc++, a stream of ours may find facets that were never made, and crash.
template <class T>
std::string word(const T& part) {
  if constexpr (std::is_integral_v<T>) {
    return std::to_string(part);
  } else if constexpr (std::is_floating_point_v<T>) {
    return fmt::format("{}", part);
  } else if constexpr (std::is_convertible_v<T, std::string>) {
    return part;
  } else if constexpr (std::is_same_v<T, at::ScalarType>) {
    return at::toString(part);
  } else if constexpr (std::is_same_v<T, at::Device>) {
    return part.str();
  } else {
    std::string shape;
    for (const std::int64_t side : at::IntArrayRef(part)) shape += (shape.empty() ? "[" : ", ") + std::to_string(side);
    return shape.empty() ? "[]" : shape + "]";
  }
}

template <class... Parts>
std::string words(const Parts&... parts) {
  return (word(parts) + ...);
}

/// Throws c10::Error that names `operation` and `name` unless the tensor is a contiguous one of that type, shape and
/// device.
inline void check_tensor(const torch::Tensor& tensor, const char* operation, const char* name, at::ScalarType type,
                         at::IntArrayRef shape, const at::Device& device) {
  TORCH_CHECK(tensor.defined(), words(operation, ": ", name, " is undefined"));
  TORCH_CHECK(tensor.scalar_type() == type,
              words(operation, ": ", name, " is ", tensor.scalar_type(), ", ", type, " is needed"));
  TORCH_CHECK(tensor.device() == device,
              words(operation, ": ", name, " is on ", tensor.device(), ", the others are on ", device));
  TORCH_CHECK(tensor.sizes() == shape, words(operation, ": ", name, " is ", tensor.sizes(), ", ", shape, " is needed"));
  TORCH_CHECK(tensor.layout() == at::kStrided && tensor.is_contiguous(),
              words(operation, ": ", name, " is not contiguous; contiguous() makes a copy that is"));
}

}  // namespace splatbus::raster
