#include "trainer/density.h"

#include <algorithm>
#include <cmath>
#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace splatbus::trainer {

namespace {

float logit(float probability) {
  return std::log(probability / (1.0F - probability));
}

float largest_log_scale(const GaussiansView& gaussians, std::size_t i) {
  return std::max({gaussians.plane(ParameterLayout::kLogScale)[i], gaussians.plane(ParameterLayout::kLogScale + 1)[i],
                   gaussians.plane(ParameterLayout::kLogScale + 2)[i]});
}

}  // namespace

Pruning find_prunable(const GaussiansView& gaussians, const PruneOptions& options, int active_channels,
                      const std::vector<std::uint64_t>& created_step, std::uint64_t step) {
  Pruning pruning{.mask = std::vector<std::uint8_t>(gaussians.count, 0)};
  std::vector<float> sum(gaussians.count, 0.0F);  // not finite as soon as one channel is not
  for (int channel = 0; channel < active_channels; ++channel) {
    const float* const plane = gaussians.plane(channel);
    for (std::size_t i = 0; i < gaussians.count; ++i) sum[i] += plane[i] * 1e-6F;
  }
  const float min_logit = options.min_opacity > 0 ? logit(options.min_opacity) : -1e30F;
  const float max_log_scale = std::log(options.max_scale_m);
  const float* const opacity_logit = gaussians.plane(ParameterLayout::kOpacityLogit);
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    const bool finite = std::isfinite(sum[i]);
    const bool old = step - std::min(step, created_step[i]) >= options.min_age_steps;
    const bool useless = opacity_logit[i] < min_logit || largest_log_scale(gaussians, i) > max_log_scale;
    if (finite && !(old && useless)) continue;
    pruning.mask[i] = 1;
    pruning.removed += 1;
    pruning.not_finite |= !finite;
  }
  return pruning;
}

void Densifier::observe(const raster::ParameterGradient& gradient) {
  for (std::size_t i = 0; i < gradient.count; ++i) {
    if (gradient.touched[i] == 0) continue;
    sum_[i] += gradient.mean2d_norm[i];
    steps_[i] += 1;
  }
}

void Densifier::resize(std::size_t count) {
  sum_.resize(count, 0.0F);
  steps_.resize(count, 0U);
}

void Densifier::permute(const std::vector<std::uint32_t>& keep) {
  std::vector<float> sum(keep.size());
  std::vector<std::uint32_t> steps(keep.size());
  for (std::size_t i = 0; i < keep.size(); ++i) {
    sum[i] = sum_[keep[i]];
    steps[i] = steps_[keep[i]];
  }
  sum_ = std::move(sum);
  steps_ = std::move(steps);
}

void Densifier::sample_split(const ModelPlanes& planes, std::size_t column) {
  const auto at = [&](int channel) -> float& {
    return planes.parameters[static_cast<std::size_t>(channel) * planes.capacity + column];
  };
  std::normal_distribution<float> normal;
  glm::vec3 local{};
  for (int axis = 0; axis < 3; ++axis) {
    local[axis] = normal(random_) * std::exp(at(ParameterLayout::kLogScale + axis));
    at(ParameterLayout::kLogScale + axis) -= std::log(kSplitFactor);
  }
  const int q = ParameterLayout::kRotation;
  const glm::vec3 offset = glm::normalize(glm::quat(at(q), at(q + 1), at(q + 2), at(q + 3))) * local;
  for (int axis = 0; axis < 3; ++axis) at(ParameterLayout::kMean + axis) += offset[axis];
}

ModelStore::Columns Densifier::densify(ModelStore& store, const DensifyOptions& options) {
  const GaussiansView gaussians = store.view();
  const float max_clone_log_scale = std::log(options.clone_max_scale_m);
  std::vector<std::uint32_t> chosen;
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    if (steps_[i] == 0 || sum_[i] / static_cast<float>(steps_[i]) < options.gradient_threshold) continue;
    chosen.push_back(static_cast<std::uint32_t>(i));
  }
  const auto added = store.duplicate(chosen);
  for (std::size_t k = 0; k < added.count; ++k) {
    if (largest_log_scale(store.view(), chosen[k]) <= max_clone_log_scale) continue;
    sample_split(store.planes(), chosen[k]);
    sample_split(store.planes(), added.first + k);
  }
  std::fill(sum_.begin(), sum_.end(), 0.0F);
  std::fill(steps_.begin(), steps_.end(), 0U);
  return added;
}

}  // namespace splatbus::trainer
