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
constexpr std::size_t kMostSpareRows = 32768;  // of what vanishes, behind the replica's
// Of what stands for another: how much larger it may be, in stream::kLogScaleStep, and how far away, of its size.
constexpr int kLogTwo = 710;
constexpr float kNear = 0.25F;

bool is_there(const stream::GpuRecord& record) {
  return (record.opacity_object & 0xFFU) > 0;
}

/// Whether one stands for the other, so that to see both would be too much: a page that came whole has most of its
/// Gaussians again, about where they were.
bool resembles(const stream::GpuRecord& a, const stream::GpuRecord& b) {
  if (a.opacity_object >> 8 != b.opacity_object >> 8) return false;
  const int size_a = *std::ranges::max_element(a.log_scale), size_b = *std::ranges::max_element(b.log_scale);
  const glm::vec3 apart(a.mean[0] - b.mean[0], a.mean[1] - b.mean[1], a.mean[2] - b.mean[2]);
  return std::abs(size_a - size_b) < kLogTwo &&
         glm::length(apart) < kNear * std::exp(stream::kLogScaleStep * static_cast<float>(std::min(size_a, size_b)));
}

}  // namespace

RowFeed::RowFeed(stream::Replica& replica, bool fades) : replica_(replica), rows_(replica), fades_on_(fades) {}

void RowFeed::fit(std::size_t harmonic_words) {
  if (std::exchange(harmonic_words_, harmonic_words) != harmonic_words) harmonics_.clear();  // another model
  resize(std::max(rows_.capacity(), records_.size()));
}

void RowFeed::resize(std::size_t rows) {
  records_.resize(rows);
  fades_.resize(rows, gl::kNoFade);
  harmonics_.resize(harmonic_words_ * rows);
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

void RowFeed::displace(std::uint32_t row, float fade) {
  const auto first = harmonics_.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * row);
  displaced_.push_back({records_[row], fade, {first, first + static_cast<std::ptrdiff_t>(harmonic_words_)}});
}

void RowFeed::take_rows(float now_s, gl::RowUpdate& out) {
  std::vector<std::uint32_t> harmonics;
  stream::GpuRows::Turnover turnover;
  rows_.take_records(kMostRows, out.rows, out.records, &harmonics, &turnover);
  fit(stream::harmonic_words(replica_.shown().layout));
  out.fades.resize(out.rows.size(), gl::kNoFade);
  for (std::size_t k = 0; k < out.rows.size(); ++k) {  // who moves goes on with his fade
    if (turnover.origins[k] < fades_.size()) out.fades[k] = std::max(fades_[turnover.origins[k]], gl::kNoFade);
  }
  for (std::size_t k = 0; k < out.rows.size(); ++k) {
    const std::uint32_t row = out.rows[k];
    float& fade = fades_[row];
    stream::GpuRecord &held = records_[row], &taken = out.records[k];
    const bool was = is_there(held), is = is_there(taken), vanishes = was && fade < 0;
    const std::uint32_t origin = turnover.origins[k];
    const bool leaves = was && (vanishes || turnover.left[k] != 0 || (!is && origin == row));
    if (fades_on_ && leaves && !is) {
      if (!vanishes) vanishing_.push_back({row, now_s});
      out.fades[k] = fade = vanishes ? fade : -now_s;
      taken = held;
      continue;
    }
    const bool arrives = is && origin == stream::GpuRows::kNoRow;
    const bool stands_in = leaves && arrives && !vanishes && resembles(held, taken);
    if (fades_on_ && leaves && is && !stands_in && (!vanishes || -fade + gl::kFade_s > now_s)) {
      displace(row, vanishes ? fade : -now_s);
    }
    if (stands_in) {
      out.fades[k] = fade;
    } else if (fades_on_ && arrives) {
      out.fades[k] = now_s;
    }
    fade = out.fades[k];
    held = taken;
    const auto first = harmonics.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * k);
    std::copy_n(first, harmonic_words_, harmonics_.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * row));
  }
  if (!displaced_.empty()) place_displaced(out);
}

void RowFeed::place_displaced(gl::RowUpdate& out) {
  const auto put = [&](std::size_t k) {
    const Displaced& one = displaced_.back();
    const std::uint32_t row = out.rows[k];
    out.records[k] = records_[row] = one.record;
    out.fades[k] = fades_[row] = one.fade;
    std::ranges::copy(one.harmonics, harmonics_.begin() + static_cast<std::ptrdiff_t>(harmonic_words_ * row));
    vanishing_.push_back({row, -one.fade});  // those that vanished already come late: nothing of them is seen by then
    displaced_.pop_back();
  };
  for (std::size_t k = 0, count = out.rows.size(); k < count && !displaced_.empty(); ++k) {
    if (!is_there(out.records[k])) put(k);
  }
  const std::size_t most = rows_.capacity() + kMostSpareRows;
  while (!displaced_.empty()) {
    if (spare_.empty()) {
      const std::size_t rows = records_.size();
      resize(std::max(rows, std::min(most, rows + displaced_.size())));
      for (std::size_t row = rows; row < records_.size(); ++row) spare_.push_back(static_cast<std::uint32_t>(row));
      if (spare_.empty()) break;  // the rest vanishes at once
    }
    const std::uint32_t row = spare_.back();
    spare_.pop_back();
    if (row < rows_.capacity()) continue;
    out.rows.push_back(row);
    out.records.emplace_back();
    out.fades.push_back(gl::kNoFade);
    put(out.rows.size() - 1);
  }
  displaced_.clear();
}

std::vector<std::uint32_t> RowFeed::free_vanished(float now_s) {
  std::vector<std::uint32_t> rows;
  while (!vanishing_.empty() && vanishing_.front().since_s + gl::kFade_s <= now_s) {
    const auto [row, since_s] = vanishing_.front();
    vanishing_.pop_front();
    if (fades_[row] != -since_s) continue;  // it came back
    records_[row] = {};
    fades_[row] = gl::kNoFade;
    if (row >= rows_.capacity()) spare_.push_back(row);
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
