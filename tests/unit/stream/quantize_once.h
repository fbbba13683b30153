#pragma once

#include <vector>

#include "stream/model_quantizer.h"

namespace splatbus::stream::test {

/// What a quantizer on the CPU makes of a model that it sees for the first time.
struct Quantized {
  QuantizedGaussians gaussians;
  std::vector<std::uint8_t> usable;
};

inline Quantized quantize_once(const GaussiansView& model, const StreamLayout& layout,
                               const QuantizedGaussians* held = nullptr,
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
