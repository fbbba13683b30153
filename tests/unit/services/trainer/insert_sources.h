#pragma once

#include <cstdint>
#include <type_traits>
#include <vector>

#include "bus/tensor.h"
#include "trainer/insert_batch.h"

namespace splatbus::trainer {

/// The tensors of a model/insert message with this batch, whose rows lie in host memory.
inline std::vector<bus::TensorSource> insert_sources(const InsertBatch& batch) {
  std::vector<bus::TensorSource> sources;
  for_each_plane(batch, [&]<class T>(const char* name, const std::vector<T>& planes, std::uint32_t channels) {
    std::vector<std::uint32_t> shape{static_cast<std::uint32_t>(batch.count)};
    if (std::is_floating_point_v<T>) shape.insert(shape.begin(), channels);
    sources.push_back({.name = name, .shape = shape, .type = bus::ElementTypeOf<T>::value, .data = planes.data()});
  });
  return sources;
}

}  // namespace splatbus::trainer
