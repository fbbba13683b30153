#pragma once

#include <numeric>
#include <vector>

#include "stream/held_gaussians.h"
#include "stream/model_quantizer.h"

namespace splatbus::stream::test {

/// The columns as rows 0, 1, ...
inline HeldGaussians held_of(const QuantizedGaussians& gaussians, const StreamLayout& layout) {
  HeldGaussians held(layout);
  std::vector<std::uint32_t> rows(gaussians.count());
  std::iota(rows.begin(), rows.end(), 0U);
  while (held.count() < rows.size()) held.grow();
  held.write(rows, gaussians, 0);
  return held;
}

/// What a quantizer on the CPU makes of a model that it sees for the first time.
struct Quantized {
  QuantizedGaussians gaussians;
  std::vector<std::uint8_t> usable;
};

inline Quantized quantize_once(const GaussiansView& model, const StreamLayout& layout,
                               const HeldGaussians* held = nullptr,
                               const std::vector<std::uint32_t>& held_column = {}) {
  ModelQuantizer quantizer(Device::Cpu);
  Quantized out;
  (void)quantizer.ids(model);
  quantizer.quantize(model, layout, held, held_column);
  quantizer.commit(out.gaussians, out.usable);
  return out;
}

inline float choose_mean_step(const GaussiansView& model) {
  return ModelQuantizer(Device::Cpu).choose_mean_step(model);
}

}  // namespace splatbus::stream::test
