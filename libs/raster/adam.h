#pragma once

#include <cstdint>
#include <vector>

#include "device/large_pages.h"
#include "raster/rasterizer.h"

namespace splatbus::raster {

struct AdamStep;

/// Adam (Kingma and Ba 2015) on parameter planes, only on Gaussians touched and not frozen (sparse, as Taming-3DGS and
/// gsplat's SelectiveAdam: untouched moments rest). One learning rate a channel.
class Adam {
 public:
  float beta1 = 0.9F, beta2 = 0.999F, epsilon = 1e-15F;
  /// h and l: the rates of a Gaussian fall with its own steps t to max(l, h / (h + t)) of what they are; h 0: they
  /// stay.
  float half_rate_steps = 0, least_rate = 0;

  void resize(const ParameterLayout& layout, std::size_t count, std::size_t stride);  ///< keeps old moments, new are 0
  /// keep[i] is the old column of new column i.
  void permute(const std::vector<std::uint32_t>& keep);

  /// parameters[channels][stride] in place. learning_rate has layout.channels() entries.
  void step(float* parameters, const std::uint32_t* flags, const ParameterGradient& gradient,
            const std::vector<float>& learning_rate, int threads);

  /// The next step's planes and rates, without parameters, flags and gradient; for Rasterizer::backward_step().
  [[nodiscard]] AdamStep prepare(const ParameterGradient& gradient, const std::vector<float>& learning_rate);

 private:
  ParameterLayout layout_;
  std::size_t count_ = 0, stride_ = 0;
  using Moments = std::vector<float, device::LargePageAllocator<float>>;
  Moments first_, second_;
  std::vector<std::uint32_t> steps_;  ///< a Gaussian, for its bias correction
};

}  // namespace splatbus::raster
