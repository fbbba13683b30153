#pragma once

#include <cstring>
#include <vector>

#include "bus/slab.h"
#include "bus/tensor.h"

namespace splatbus::bus_test {

/// Writes the next slot and returns it as the tensor "values".
inline bus::OutgoingTensor write_floats(bus::Slab& slab, const std::vector<float>& values) {
  const auto slot = slab.next_slot();
  std::memcpy(slab.slot_data(slot), values.data(), values.size() * sizeof(float));
  const auto generation = slab.end_write(slot);
  bus::OutgoingTensor tensor;
  tensor.name = "values";
  tensor.shape = {static_cast<std::uint32_t>(values.size())};
  tensor.span = slab.span(slot, 0, values.size() * sizeof(float), generation);
  return tensor;
}

}  // namespace splatbus::bus_test
