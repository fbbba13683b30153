#include "raster/adam.h"

#include <algorithm>
#include <stdexcept>

#include "raster/adam_kernel.h"
#include "raster/cpu/workers.h"

namespace splatbus::raster {

void Adam::resize(const ParameterLayout& layout, std::size_t count, std::size_t stride) {
  if (layout == layout_ && stride == stride_ && !first_.empty()) {
    // Columns that come back after a shrink begin anew.
    for (std::size_t i = count; i < count_; ++i) steps_[i] = 0;
    for (Moments* moments : {&first_, &second_}) {
      for (int c = 0; c < layout.channels(); ++c) {
        float* plane = moments->data() + static_cast<std::size_t>(c) * stride;
        for (std::size_t i = count; i < count_; ++i) plane[i] = 0;
      }
    }
    count_ = count;
    return;
  }
  const std::size_t kept = layout == layout_ ? std::min(count, count_) : 0;
  for (Moments* moments : {&first_, &second_}) {
    Moments moved(static_cast<std::size_t>(layout.channels()) * stride, 0.0F);
    for (int c = 0; c < layout.channels() && kept > 0; ++c) {
      const auto plane = static_cast<std::size_t>(c);
      std::copy_n(moments->data() + plane * stride_, kept, moved.data() + plane * stride);
    }
    *moments = std::move(moved);
  }
  steps_.resize(kept);
  steps_.resize(stride, 0);
  layout_ = layout;
  count_ = count;
  stride_ = stride;
}

void Adam::permute(const std::vector<std::uint32_t>& keep) {
  if (keep.size() > stride_) throw std::invalid_argument("Adam: more columns kept than there is room for");
  for (const std::uint32_t old : keep) {
    if (old >= count_) throw std::invalid_argument("Adam: a kept column does not exist");
  }
  std::vector<float> moved(stride_);
  const auto gather = [&](auto* values, auto& scratch) {
    for (std::size_t i = 0; i < keep.size(); ++i) scratch[i] = values[keep[i]];
    std::copy_n(scratch.begin(), keep.size(), values);
    std::fill(values + keep.size(), values + std::max(count_, keep.size()), 0);
  };
  for (Moments* moments : {&first_, &second_}) {
    for (int c = 0; c < layout_.channels(); ++c) gather(moments->data() + static_cast<std::size_t>(c) * stride_, moved);
  }
  std::vector<std::uint32_t> moved_steps(stride_);
  gather(steps_.data(), moved_steps);
  count_ = keep.size();
}

AdamStep Adam::prepare(const ParameterGradient& gradient, const std::vector<float>& learning_rate) {
  if (gradient.layout != layout_ || gradient.count != count_) {
    throw std::invalid_argument("Adam: resize() has not followed the model");
  }
  if (learning_rate.size() != static_cast<std::size_t>(layout_.channels())) {
    throw std::invalid_argument("Adam: one learning rate a channel is needed");
  }
  const int channels = layout_.channels();
  AdamStep step;
  step.channels = gradient.active_channels > 0 ? std::min(gradient.active_channels, channels) : channels;
  step.stride = gradient.stride;
  step.moment_stride = stride_;
  step.touched = gradient.touched.data();
  step.learning_rate = learning_rate.data();
  step.first = first_.data();
  step.second = second_.data();
  step.steps = steps_.data();
  step.beta1 = beta1;
  step.beta2 = beta2;
  step.epsilon = epsilon;
  step.half_rate_steps = half_rate_steps;
  step.least_rate = least_rate;
  return step;
}

void Adam::step(float* parameters, const std::uint32_t* flags, const ParameterGradient& gradient,
                const std::vector<float>& learning_rate, int threads) {
  AdamStep step = prepare(gradient, learning_rate);
  step.parameters = parameters;
  step.flags = flags;
  step.gradient = gradient.values.data();
  step.gradient_stride = gradient.stride;
  cpu::Workers(threads).for_pieces(count_, kAdamPiece,
                                   [&](std::size_t begin, std::size_t end) { adam_range(step, begin, end); });
}

}  // namespace splatbus::raster
