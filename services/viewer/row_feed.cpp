#include "viewer/row_feed.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "viewer/gl/shaders.h"

namespace splatbus::viewer {
namespace {

constexpr std::size_t kMostRows = stream::kMaxGaussians * 2;  // a batch: all, as objects may have other indices
constexpr std::size_t kSampled = 20000;                       // rows, for the bounds
constexpr double kOutside = 0.03;                             // of the samples along each axis, on either side
constexpr float kBoundsEvery_s = 1;

bool is_there(const stream::GpuRecord& record) {
  return (record.opacity_object & 0xFFU) > 0;
}

}  // namespace

RowFeed::RowFeed(stream::Replica& replica, bool fades) : replica_(replica), rows_(replica), fades_on_(fades) {}

void RowFeed::fit(std::size_t harmonic_words) {
  if (rows_.capacity() > records_.size()) {
    records_.resize(rows_.capacity());
    fades_.resize(rows_.capacity(), gl::kNoFade);
  }
  if (std::exchange(harmonic_words_, harmonic_words) != harmonic_words) harmonics_.clear();  // another model
  harmonics_.resize(harmonic_words * records_.size());
}

void RowFeed::add_harmonics(gl::RowUpdate& out) const {
  out.harmonic_words = harmonic_words_;
  if (harmonic_words_ == 0) return;
  out.harmonics.reserve(harmonic_words_ * out.rows.size());
  for (const std::uint32_t row : out.rows) {
    const auto first = harmonics_.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * row);
    out.harmonics.insert(out.harmonics.end(), first, first + static_cast<std::ptrdiff_t>(harmonic_words_));
  }
}

void RowFeed::take_rows(float now_s, gl::RowUpdate& out) {
  std::vector<std::uint32_t> harmonics;
  rows_.take_records(kMostRows, out.rows, out.records, &harmonics);
  fit(stream::harmonic_words(replica_.shown().layout));
  out.fades.resize(out.rows.size());
  for (std::size_t k = 0; k < out.rows.size(); ++k) {
    const std::uint32_t row = out.rows[k];
    float& fade = fades_[row];
    const bool was = is_there(records_[row]) && fade >= 0, is = is_there(out.records[k]);
    if (fades_on_ && was && !is) {
      out.records[k] = records_[row];
      fade = -now_s;
      vanishing_.push_back({row, now_s});
    } else {
      if (fades_on_ && is && !was) fade = now_s;
      if (!is && fade < 0) out.records[k] = records_[row];
      records_[row] = out.records[k];
      if (is) {
        const auto first = harmonics.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * k);
        std::copy_n(first, harmonic_words_, harmonics_.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * row));
      }
    }
    out.fades[k] = fade;
  }
}

std::vector<std::uint32_t> RowFeed::free_vanished(float now_s) {
  std::vector<std::uint32_t> rows;
  while (!vanishing_.empty() && vanishing_.front().since_s + gl::kFade_s <= now_s) {
    const auto [row, since_s] = vanishing_.front();
    vanishing_.pop_front();
    if (fades_[row] != -since_s) continue;  // it came back
    records_[row] = {};
    fades_[row] = gl::kNoFade;
    rows.push_back(row);
  }
  return rows;
}

void RowFeed::describe(gl::Batch& batch) const {
  batch.object_ids = rows_.object_ids();
  batch.display_space = replica_.layout().appearance == Appearance::Radiance;
  batch.colors_ns = colors_ns_;
  batch.scene_ns = replica_.scene_instant().capture_ns;
}

gl::SharedBatch RowFeed::take(float now_s) {
  auto batch = std::make_shared<gl::Batch>();
  color_times_.see(replica_);
  const std::vector<std::uint32_t> vanished = free_vanished(now_s);
  take_rows(now_s, batch->update);
  for (const std::uint32_t row : vanished) {
    if (is_there(records_[row])) continue;  // taken again
    batch->update.rows.push_back(row);
    batch->update.records.emplace_back();
    batch->update.fades.push_back(gl::kNoFade);
  }
  add_harmonics(batch->update);
  if (rows_.unsent() == 0) {
    rows_.take_colors(kMostRows, batch->colors.rows, batch->colors.colors);
    colors_ns_ = color_times_.taken(replica_, batch->colors.rows.size() == kMostRows);
    for (std::size_t k = 0; k < batch->colors.rows.size(); ++k) {
      records_[batch->colors.rows[k]].color = batch->colors.colors[k];
    }
  }
  if (batch->update.rows.empty() && batch->colors.rows.empty()) return nullptr;
  batch->whole = !std::exchange(begun_, true);
  if (bounded_s_ < 0 || now_s - bounded_s_ > kBoundsEvery_s) {
    batch->bounds = bounds();
    bounded_s_ = now_s;
  }
  describe(*batch);
  return batch;
}

gl::SharedBatch RowFeed::everything() const {
  auto batch = std::make_shared<gl::Batch>();
  batch->whole = true;
  for (std::size_t row = 0; row < records_.size(); ++row) {
    if (!is_there(records_[row])) continue;
    batch->update.rows.push_back(static_cast<std::uint32_t>(row));
    batch->update.records.push_back(records_[row]);
    batch->update.fades.push_back(fades_[row]);
  }
  add_harmonics(batch->update);
  describe(*batch);
  batch->bounds = bounds();
  return batch;
}

std::optional<gl::Bounds> RowFeed::bounds() const {
  const std::size_t step = std::max<std::size_t>(1, records_.size() / kSampled);
  const std::vector<std::uint32_t> ids = rows_.object_ids();
  const SceneState& scene = replica_.scene();
  std::array<std::vector<float>, 3> axes;
  for (std::size_t row = 0; row < records_.size(); row += step) {
    const stream::GpuRecord& record = records_[row];
    const std::uint32_t id = ids[std::min<std::size_t>(record.opacity_object >> 8, ids.size() - 1)];
    if (!is_there(record) || id == kFarFieldFrame) continue;
    glm::vec3 point(record.mean[0], record.mean[1], record.mean[2]);
    if (const auto object = scene.objects.find(id); id != kWorldFrame && object != scene.objects.end()) {
      point = object->second * point;
    }
    for (int axis = 0; axis < 3; ++axis) axes[static_cast<std::size_t>(axis)].push_back(point[axis]);
  }
  if (axes[0].empty()) return std::nullopt;
  gl::Bounds out;
  glm::vec3 half(0);
  for (int axis = 0; axis < 3; ++axis) {
    auto& values = axes[static_cast<std::size_t>(axis)];
    std::sort(values.begin(), values.end());
    const auto outside = static_cast<std::size_t>(kOutside * static_cast<double>(values.size()));
    const float low = values[outside], high = values[values.size() - 1 - outside];
    out.centre[axis] = (low + high) / 2;
    half[axis] = (high - low) / 2;
  }
  out.radius_m = std::max(glm::length(half), 0.1F);
  return out;
}

}  // namespace splatbus::viewer
