#pragma once

#include "raster/cuda/gaussian_channels.cuh"
#include "raster/cuda/kernels.h"
#include "raster/learning_age.h"

namespace splatbus::raster::cuda {

__device__ inline float square_root(float x) {
  float y;
  asm("sqrt.approx.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}

/// Where gradients go: Adam in place (Kingma and Ba 2015), each Gaussian with a step count of its own.
struct AdamSink {
  static constexpr int kLanes = static_cast<int>(kPageLanes);

  DeviceGaussians gaussians;
  OptimizerState state;
  AdamOptions options;
  int active_channels;
  float correction1 = 1.0F, correction2 = 1.0F;

  /// Of channel 0: the first moment. The second one of a channel lies `second()` behind its first.
  [[nodiscard]] __device__ float* moments(int i) const {
    const auto index = static_cast<std::uint32_t>(i);
    return state.blocks[index >> kPageShift] + (index & (kPageLanes - 1));
  }
  [[nodiscard]] __device__ int second() const { return state.channels * kLanes; }

  /// Of a Gaussian that is blended into `item.views`.
  template <class Item>
  __device__ void begin(const Item& item, const float3 mean) {
    float* const counters = moments(item.i) + 2 * second();
    std::uint32_t& steps = *reinterpret_cast<std::uint32_t*>(counters);
    const std::uint32_t taken = steps + 1;
    steps = taken;
    const auto step = static_cast<float>(taken);
    const float half = options.lr_half_life_steps;
    const float rate = half > 0.0F ? fmaxf(options.lr_min_factor, half / (half + age(item, mean, step))) : 1.0F;
    correction1 = rate / (1.0F - exp2f(step * log2f(options.beta1)));
    correction2 = 1.0F / (1.0F - exp2f(step * log2f(options.beta2)));
  }

  /// Takes the step's views into its age, and returns that.
  template <class Item>
  __device__ float age(const Item& item, const float3 mean, float step) const {
    float detail = 0.0F;
    bool risen = false;
    for (int b = 0; b < item.w.batch; ++b) {
      if ((item.views >> b & 1U) == 0) continue;
      const float* row = item.object(b).view_from_object + 8;
      const float depth_m = row[0] * mean.x + row[1] * mean.y + row[2] * mean.z + row[3];
      const float px_per_m = __fdividef(item.w.views[b].fx, fmaxf(depth_m, kNearestDepth_m));
      detail = fmaxf(detail, px_per_m * px_per_m);
      risen = risen || (options.loss_limits != nullptr && item.w.loss[b] > options.loss_limits[b]);
    }
    float* const counters = moments(item.i) + 2 * second();
    LearningAge so_far{counters[kLanes], counters[2 * kLanes]};
    if (risen && gradients_agree(item.i, step)) so_far.near_steps *= kRecovery;
    so_far.advance(detail);
    counters[kLanes] = so_far.near_steps;
    counters[2 * kLanes] = so_far.detail;
    return so_far.of(step);
  }

  /// Of colour, over the last steps.
  [[nodiscard]] __device__ bool gradients_agree(int i, float step) const {
    const float* const first = moments(i) + ParameterLayout::kAppearance * kLanes;
    float mean2 = 0.0F, square = 0.0F;
    for (int c = 0; c < 3; ++c) {
      mean2 += first[c * kLanes] * first[c * kLanes];
      square += first[c * kLanes + second()];
    }
    const float bias1 = 1.0F - exp2f(step * log2f(options.beta1)), bias2 = 1.0F - exp2f(step * log2f(options.beta2));
    return mean2 * bias2 > kAgreement * square * bias1 * bias1;
  }

  /// Channels first, first + spacing, ... with their present values; all loads come before the first store, so that
  /// they overlap.
  template <int kChannels, bool kUnit = false>
  __device__ void put(int first, int spacing, int i, const float* value, const float* gradient) const {
    float m[kChannels], v[kChannels];
    float* const first_moments = moments(i) + first * kLanes;
    float* const second_moments = first_moments + second();
#pragma unroll
    for (int k = 0; k < kChannels; ++k) {
      const bool active = first + k * spacing < active_channels;
      m[k] = active ? first_moments[k * spacing * kLanes] : 0.0F;
      v[k] = active ? second_moments[k * spacing * kLanes] : 0.0F;
    }
    const ChannelsOfOne<float> parameters = parameters_of(gaussians).of(recomputed(i), first);
#pragma unroll
    for (int k = 0; k < kChannels; ++k) {
      const int channel = first + k * spacing;
      if (channel >= active_channels) continue;
      m[k] = options.beta1 * m[k] + (1.0F - options.beta1) * gradient[k];
      v[k] = options.beta2 * v[k] + (1.0F - options.beta2) * gradient[k] * gradient[k];
      first_moments[k * spacing * kLanes] = m[k];
      second_moments[k * spacing * kLanes] = v[k];
      const float scale = square_root(v[k] * correction2) + options.epsilon;
      float next = value[k] - __fdividef(options.learning_rate[channel] * m[k] * correction1, scale);
      if (kUnit && options.unit_albedo) next = fminf(fmaxf(next, 0.0F), 1.0F);
      parameters[k * spacing] = next;
    }
  }
};

}  // namespace splatbus::raster::cuda
