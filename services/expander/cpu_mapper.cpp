#include "expander/cpu_mapper.h"

#include <algorithm>
#include <utility>

namespace splatbus::expander {

namespace {

class HostRound final : public Round {
 public:
  explicit HostRound(InputSamples samples) : samples_(std::move(samples)) {}
  [[nodiscard]] const RoundInfo& info() const override { return samples_; }
  [[nodiscard]] std::size_t size() const override { return samples_.size(); }
  [[nodiscard]] std::size_t dropped() const override { return samples_.dropped; }
  [[nodiscard]] const InputSamples& samples() const { return samples_; }

 private:
  InputSamples samples_;
};

glm::vec3 vector_at(const float* planes, std::size_t stride, std::size_t i) {
  return {planes[i], planes[stride + i], planes[2 * stride + i]};
}

Frame frame_of(CellId cell, std::uint32_t object_id) {
  return {.local = (cell & kObjectCell) != 0, .object_id = object_id};
}

}  // namespace

CpuMapper::CpuMapper(float cell_size_m) : grid_({.cell_size_m = cell_size_m}) {}

std::unique_ptr<Round> CpuMapper::take(const IncomingRound& round) {
  auto samples = copy_samples(round, host_bytes_);
  return samples ? std::make_unique<HostRound>(std::move(*samples)) : nullptr;
}

Growth CpuMapper::grow(const Round& round, const GrowOptions& options) {
  const InputSamples& samples = static_cast<const HostRound&>(round).samples();
  grid_.set_options(options.grid);
  const auto seen = seen_samples(samples, options.visibility);
  const std::vector<Chosen> chosen = grid_.choose(samples, seen, options.viewer, options.room);
  Growth growth{.unseen = static_cast<std::size_t>(std::count(seen.begin(), seen.end(), false)),
                .chosen = chosen.size(),
                .batches = {}};
  const std::span<const Chosen> all(chosen);
  for (std::size_t first = 0; first < all.size(); first += options.batch_size) {
    const auto part = all.subspan(first, std::min(options.batch_size, all.size() - first));
    growth.batches.push_back(initial_gaussians(samples, part, options.initial));
    host_bytes_ += growth.batches.back().bytes();
  }
  return growth;
}

void CpuMapper::add(const InsertBatch& batch) {
  const InsertPlanes planes = batch.planes();
  for (std::size_t i = 0; i < batch.size(); ++i) {
    grid_.add_modelled(frame_of(planes.cell[i], planes.object_id[i]), vector_at(planes.mean, batch.size(), i),
                       vector_at(planes.normal, batch.size(), i));
  }
}

bool CpuMapper::holds_any(const InsertBatch& batch) {
  const InsertPlanes planes = batch.planes();
  for (std::size_t i = 0; i < batch.size(); ++i) {
    const Frame frame = frame_of(planes.cell[i], planes.object_id[i]);
    if (grid_.contains(frame, vector_at(planes.mean, batch.size(), i))) return true;
  }
  return false;
}

bool CpuMapper::adopt(const PublishedModel& model) {
  const GaussiansView& view = model.live();
  Grid grid(grid_.options());
  for (std::size_t i = 0; i < view.count; ++i) {
    grid.add_modelled(frame_of(view.cell[i], view.object_id[i]), vector_at(view.surface_point, view.stride, i),
                      vector_at(view.normal, view.stride, i));
  }
  host_bytes_ += model.copied_bytes();
  if (!model.still_valid()) return false;
  grid_ = std::move(grid);
  return true;
}

std::vector<CellCounts> CpuMapper::cells() {
  std::vector<CellCounts> counts;
  counts.reserve(grid_.cells().size());
  for (const auto& [id, cell] : grid_.cells()) {
    counts.push_back({.cell = id, .samples = cell.samples, .points = static_cast<std::uint32_t>(cell.points.size())});
  }
  return counts;
}

}  // namespace splatbus::expander
