#include "trainer/cell_stats.h"

#include <algorithm>
#include <cmath>
#include <glm/glm.hpp>

namespace splatbus::trainer {

namespace {

constexpr float kMemory = 0.98F;  // of a cell's figures, a sample

float pixel_error(const raster::Image& color, const Pixels<std::uint8_t>& target, std::size_t pixel,
                  bool display_space) {
  float error = 0;
  for (std::uint32_t c = 0; c < 3; ++c) {
    const float value = std::clamp(color.plane(c)[pixel], 0.0F, 1.0F);
    const float shown = display_space ? value : srgb_from_linear(value);
    error += std::abs(shown - static_cast<float>(target[4 * pixel + c]) / 255.0F);
  }
  return error / 3.0F;
}

}  // namespace

void CellTable::recount(const std::uint64_t* cell, std::size_t count) {
  for (auto& [id, figures] : cells_) figures.count = 0;
  for (std::size_t i = 0; i < count; ++i) ++cells_[cell[i]].count;
  forget_empty();
}

void CellTable::recount(std::span<const std::uint64_t> cells, std::span<const std::uint32_t> counts) {
  for (auto& [id, figures] : cells_) figures.count = 0;
  for (std::size_t k = 0; k < cells.size(); ++k) cells_[cells[k]].count = counts[k];
  forget_empty();
}

void CellTable::forget_empty() {
  std::erase_if(cells_, [](const auto& entry) { return entry.second.count == 0; });
}

void CellTable::observe(std::uint64_t cell, std::size_t samples, float loss, float movement) {
  Cell& figures = cells_[cell];
  const float share = figures.seen ? 1.0F - std::pow(kMemory, static_cast<float>(samples)) : 1.0F;
  figures.loss += share * (loss - figures.loss);
  figures.movement += share * (movement - figures.movement);
  figures.seen = true;
}

void CellSampler::observe(const ModelPlanes& planes, std::size_t count, const TrainingView& view,
                          const raster::Image& color, bool display_space, const std::vector<float>& contribution,
                          CellTable& cells) {
  const GaussiansView gaussians = planes.view(count);
  const auto column = [&](const float* from, int channel, std::size_t i) {
    return glm::vec3(from[static_cast<std::size_t>(channel) * planes.capacity + i],
                     from[static_cast<std::size_t>(channel + 1) * planes.capacity + i],
                     from[static_cast<std::size_t>(channel + 2) * planes.capacity + i]);
  };
  const std::size_t samples = std::min(count, kSamplesAStep);
  for (std::size_t k = 0; k < samples; ++k) {
    if (next_ >= count) next_ = 0;
    const std::size_t i = next_++;
    if (contribution[i] < kMinContribution) continue;
    const glm::vec3 mean = column(gaussians.parameters, ParameterLayout::kMean, i);
    const auto object = view.scene.objects.find(planes.object_id[i]);
    const glm::vec3 world = object == view.scene.objects.end() ? mean : object->second * mean;
    const glm::vec3 at = project(view.camera, world);
    if (!(at.z > 0) || !(at.x >= 0) || !(at.y >= 0)) continue;
    if (at.x >= static_cast<float>(view.camera.width) || at.y >= static_cast<float>(view.camera.height)) continue;
    const std::size_t pixel = static_cast<std::size_t>(at.y) * view.camera.width + static_cast<std::size_t>(at.x);

    const glm::vec3 log_scale = column(gaussians.parameters, ParameterLayout::kLogScale, i);
    const float deviation_m = std::exp(std::max({log_scale.x, log_scale.y, log_scale.z}));
    const float moved_m = glm::distance(mean, column(planes.average, ParameterLayout::kMean, i));
    cells.observe(planes.cell[i], 1, pixel_error(color, view.color, pixel, display_space),
                  moved_m / std::max(deviation_m, 1e-6F));
  }
}

}  // namespace splatbus::trainer
