#include "stream/delta_selection.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "stream/pieces.h"
#include "stream/replicated_state.h"
#include "stream/value_changes.h"

namespace splatbus::stream {

namespace {

constexpr float kMaxAreaPx2 = 400;  // a Gaussian right before the camera is not worth more than this
constexpr float kOutsideShare = 0.1F;
constexpr float kCentimetres2 = 1e4F;

struct View {
  Camera camera;
  Rigid camera_from_world;
};

float area_px2(const View& view, const glm::vec3& mean_world, float sigma2_m2) {
  const glm::vec3 p = view.camera_from_world * mean_world;
  const float depth = std::max(std::abs(p.z), view.camera.near_m);
  const float area = std::min(sigma2_m2 * view.camera.fx * view.camera.fy / (depth * depth), kMaxAreaPx2);
  const float margin = 3 * std::sqrt(area);
  const float x = view.camera.fx * p.x / depth + view.camera.cx, y = view.camera.fy * p.y / depth + view.camera.cy;
  const bool inside = p.z > view.camera.near_m && x > -margin && y > -margin &&
                      x < static_cast<float>(view.camera.width) + margin &&
                      y < static_cast<float>(view.camera.height) + margin;
  return inside ? area : kOutsideShare * area;
}

constexpr std::int32_t kCalmZone = 1;  // steps: rounding alone can toggle a value by one
constexpr std::size_t kBuckets = 512;  // of score, eight an octave
static_assert(kChunkRows % kBlockRows == 0);

bool is_delta_coded(Attribute attribute) {
  return attribute != Attribute::Normal && attribute != Attribute::Visibility;
}

/// From 2^-40 on; log2() would take longer than all else that is done for a candidate.
std::uint32_t bucket(float score) {
  constexpr std::uint32_t kFirst = 127 - 40, kMantissa = (1U << 23U) - 1;
  // Of 2^(1/8), 2^(2/8), ...
  constexpr std::array<std::uint32_t, 7> kEighths = {759234, 1587185, 2490071, 3474676, 4548395, 5719293, 6996167};
  const auto bits = std::bit_cast<std::uint32_t>(std::max(score, 0x1p-40F));
  std::uint32_t eighths = 8 * ((bits >> 23U) - kFirst);
  for (const std::uint32_t from : kEighths) eighths += (bits & kMantissa) >= from ? 1 : 0;
  return std::min(eighths, static_cast<std::uint32_t>(kBuckets - 1));
}

/// Of one Gaussian after the other.
template <class Gaussians>
class Shares {
 public:
  Shares(const Gaussians& gaussians, const StreamLayout& layout, std::span<const Camera> cameras,
         const ObjectTransforms& objects)
      : gaussians_(gaussians),
        objects_(objects),
        mean_(layout.at(Attribute::Mean)),
        scale_(layout.at(Attribute::LogScale)),
        opacity_(layout.at(Attribute::Opacity)) {
    for (const Camera& camera : cameras) views_.push_back({camera, inverse(camera.world_from_camera)});
  }

  float operator()(std::size_t i) const {
    const float a = value(scale_, 0, i), b = value(scale_, 1, i), c = value(scale_, 2, i);
    float sigma2 = std::exp(std::min(a + b + c - std::min({a, b, c}), 10.0F));
    glm::vec3 p(value(mean_, 0, i), value(mean_, 1, i), value(mean_, 2, i));
    const std::uint32_t object_id = gaussians_.object_id[i];
    float shown = 1;
    if (object_id != 0) {
      if (const auto object = objects_.find(object_id); object != objects_.end()) {
        p = object->second * p;
        sigma2 *= object->second.scale * object->second.scale;
      } else {
        shown = kOutsideShare;  // it is hidden, and may come back
      }
    }
    float area = views_.empty() ? std::min(sigma2 * kCentimetres2, kMaxAreaPx2) : 0;
    for (const View& view : views_) {
      if (object_id == kFarFieldFrame) {
        const ObjectTransform seen = seen_from(view.camera.world_from_camera.translation, kFarFieldFrame, {});
        area = std::max(area, area_px2(view, seen * p, sigma2 * seen.scale * seen.scale));
      } else {
        area = std::max(area, area_px2(view, p, sigma2));
      }
    }
    return shown * area * value(opacity_, 0, i);
  }

 private:
  [[nodiscard]] float value(const AttributeChannels& a, int channel, std::size_t i) const {
    return a.quantizer.offset + a.quantizer.step * static_cast<float>(gaussians_.channels[a.first + channel][i]);
  }
  const Gaussians& gaussians_;
  const ObjectTransforms& objects_;
  const AttributeChannels &mean_, &scale_, &opacity_;
  std::vector<View> views_;
};

}  // namespace

void picture_share(const HeldGaussians& gaussians, const StreamLayout& layout, std::span<const std::uint32_t> blocks,
                   std::span<const Camera> cameras, const ObjectTransforms& objects, std::span<float> share) {
  const Shares of(gaussians, layout, cameras, objects);
  for_each_piece(blocks, kPieceBlocks, [&](std::size_t, std::span<const std::uint32_t> piece) {
    for (const std::uint32_t block : piece) {
      const std::size_t first = std::size_t{block} * kBlockRows;
      for (std::size_t row = first; row < first + kBlockRows; ++row) share[row] = of(row);
    }
  });
}

std::vector<float> picture_share(const QuantizedGaussians& gaussians, const StreamLayout& layout,
                                 std::span<const Camera> cameras, const ObjectTransforms& objects) {
  const Shares of(gaussians, layout, cameras, objects);
  std::vector<float> share(gaussians.count());
  for (std::size_t i = 0; i < share.size(); ++i) share[i] = of(i);
  return share;
}

Schedules default_schedules() {
  Schedules s{};
  const auto set = [&](Attribute attribute, AttributeSchedule schedule) {
    s[static_cast<std::size_t>(attribute)] = schedule;
  };
  // A step of a mean is a 32nd of a typical sigma, of a scale 1.6 %, of a rotation 0.45 degrees, of colors 1/255, of a
  // residual 1/128. Residuals add up over their coefficients: resting a step off, they cost 8 dB (docs/decisions/0051).
  set(Attribute::Mean, {.dead_zone = 2, .every = 1, .weight = 2});
  set(Attribute::LogScale, {.dead_zone = 2, .every = 1, .weight = 2});
  set(Attribute::Rotation, {.dead_zone = 3, .every = 2, .weight = 1});
  set(Attribute::Opacity, {.dead_zone = 2, .every = 1, .weight = 1});
  set(Attribute::Albedo, {.dead_zone = 1, .every = 1, .weight = 2});
  set(Attribute::Residual, {.dead_zone = 0, .every = 2, .weight = 1});
  set(Attribute::ShDc, {.dead_zone = 1, .every = 1, .weight = 2});
  set(Attribute::ShRest, {.dead_zone = 1, .every = 3, .weight = 0.5F});
  return s;
}

DeltaSelection::DeltaSelection(const StreamLayout& layout, const Schedules& schedules, std::uint32_t calm_ticks,
                               float coarseness)
    : layout_(layout), schedules_(schedules), calm_ticks_(std::min(calm_ticks, 255U)), precision_(layout, coarseness) {
  anchor_.resize(static_cast<std::size_t>(layout.channels()));
  calm_.resize(layout.attributes().size());
  for (const AttributeChannels& a : layout.attributes()) bytes_per_entry_.push_back(0.6 + 0.7 * a.channels);
}

const AttributeSchedule& DeltaSelection::schedule(std::uint32_t attribute) const {
  return schedules_[static_cast<std::size_t>(layout_.attributes()[attribute].attribute)];
}

void DeltaSelection::resize(std::size_t rows) {
  for (auto& anchor : anchor_) anchor.resize(rows);
  for (auto& calm : calm_) calm.resize(rows);
}

void DeltaSelection::begin(std::uint32_t row, const HeldGaussians& held) {
  for (std::size_t c = 0; c < anchor_.size(); ++c) anchor_[c][row] = held.channels[c][row];
  for (auto& calm : calm_) calm[row] = 0;
}

void DeltaSelection::move(std::uint32_t from, std::uint32_t to) {
  for (auto& anchor : anchor_) anchor[to] = anchor[from];
  for (auto& calm : calm_) calm[to] = calm[from];
}

double DeltaSelection::bytes_per_entry(Attribute attribute) const {
  for (std::size_t a = 0; a < layout_.attributes().size(); ++a) {
    if (layout_.attributes()[a].attribute == attribute) return bytes_per_entry_[a];
  }
  return 1;
}

void DeltaSelection::collect(std::uint32_t attribute, const HeldGaussians& held, const QuantizedGaussians& target,
                             std::span<const std::uint32_t> target_column, std::span<const std::uint32_t> blocks,
                             std::span<const float> share, Found& found) {
  const AttributeChannels& a = layout_.attributes()[attribute];
  const AttributeSchedule& plan = schedule(attribute);
  const float scale = plan.weight / static_cast<float>(bytes_per_entry_[attribute]);
  auto& calm = calm_[attribute];
  auto& candidates = found.candidates[attribute];
  auto& count = found.count[attribute];
  std::array<std::int32_t, kBlockRows> largest, sum, drift;
  for (const std::uint32_t block : blocks) {
    const std::size_t first = std::size_t{block} * kBlockRows;
    largest.fill(0);
    sum.fill(0);
    drift.fill(0);
    for (int c = a.first; c < a.first + a.channels; ++c) {
      held.channels[c].visit(first, [&](const auto* from) {
        add_changes(target.channels[c].data(), target_column.data() + first, from, anchor_[c].data() + first,
                    kBlockRows, {largest.data(), sum.data(), drift.data()});
      });
    }
    for (std::size_t i = 0; i < kBlockRows; ++i) {
      const auto row = static_cast<std::uint32_t>(first + i);
      const std::uint32_t column = target_column[row];
      if (column == kNotHeld) continue;
      const int shift = drift[i] > 1 || largest[i] > 0 ? precision_.shift(attribute, classes_[row]) : 0;
      if (drift[i] > 1 << shift) {
        for (int c = a.first; c < a.first + a.channels; ++c) anchor_[c][row] = target.channels[c][column];
        calm[row] = 0;
      } else if (calm[row] < calm_ticks_) {
        ++calm[row];
      }
      const std::int32_t zone = calm[row] < calm_ticks_ ? plan.dead_zone : std::min(kCalmZone, plan.dead_zone);
      // What is rounded is off by half of what it is rounded to, and one that wavers about that stays.
      if (largest[i] <= std::max(zone << shift, (1 << shift) >> 1)) continue;
      const auto steps = static_cast<float>(sum[i]);
      candidates.push_back({bucket(share[row] * steps * scale), steps * plan.weight, row});
      ++count[candidates.back().bucket];
    }
  }
}

void DeltaSelection::classify(const QuantizedGaussians& target, std::span<const std::uint32_t> target_column,
                              std::span<const std::uint32_t> blocks) {
  for (const std::uint32_t block : blocks) {
    for (std::size_t row = std::size_t{block} * kBlockRows; row < (std::size_t{block} + 1) * kBlockRows; ++row) {
      classes_[row] = target_column[row] != kNotHeld && !precision_.lossless()
                          ? precision_.of(target, target_column[row])
                          : Precision::Class{};
    }
  }
}

bool DeltaSelection::is_due(std::uint32_t attribute) const {
  return is_delta_coded(layout_.attributes()[attribute].attribute) &&
         tick_ % std::max(schedule(attribute).every, 1U) == 0;
}

std::vector<SelectedRows> DeltaSelection::select(const HeldGaussians& held, const QuantizedGaussians& target,
                                                 std::span<const std::uint32_t> target_column,
                                                 std::span<const std::uint32_t> blocks, std::span<const float> share,
                                                 double budget_bytes) {
  const auto attributes = static_cast<std::uint32_t>(layout_.attributes().size());
  classes_.resize(target_column.size());
  found_.resize(pieces_of(blocks.size(), kPieceBlocks));
  for_each_piece(blocks, kPieceBlocks, [&](std::size_t k, std::span<const std::uint32_t> piece) {
    Found& found = found_[k];
    found.candidates.resize(attributes);
    found.count.resize(attributes);
    for (auto& candidates : found.candidates) candidates.clear();
    for (auto& count : found.count) count.assign(kBuckets, 0);
    if (target.count() == 0) return;
    classify(target, target_column, piece);
    for (std::uint32_t a = 0; a < attributes; ++a) {
      if (is_due(a)) collect(a, held, target, target_column, piece, share, found);
    }
  });
  ++tick_;

  std::vector<double> cost(kBuckets);
  for (std::uint32_t a = 0; a < attributes; ++a) {
    for (const Found& found : found_) {
      for (std::size_t b = 0; b < kBuckets; ++b) cost[b] += bytes_per_entry_[a] * found.count[a][b];
    }
  }
  std::size_t lowest = kBuckets;  // buckets from here on go out whole; of the one below, what still fits
  double left = budget_bytes;
  while (lowest > 0 && cost[lowest - 1] <= left) left -= cost[--lowest];

  std::vector<SelectedRows> selected(attributes);
  left_blocks_.clear();
  left_ = 0;
  for (std::uint32_t a = 0; a < attributes; ++a) {
    selected[a].attribute = layout_.attributes()[a].attribute;
    for (const Found& found : found_) {
      for (const Candidate& c : found.candidates[a]) {
        const bool fits = c.bucket >= lowest || (c.bucket + 1 == lowest && left >= bytes_per_entry_[a]);
        if (c.bucket < lowest && fits) left -= bytes_per_entry_[a];
        if (fits) {
          selected[a].rows.push_back(c.row);
          selected[a].steps.push_back(c.steps);
          continue;
        }
        ++left_;
        const auto block = static_cast<std::uint32_t>(c.row / kBlockRows);
        if (left_blocks_.empty() || left_blocks_.back() != block) left_blocks_.push_back(block);
      }
    }
  }
  std::ranges::sort(left_blocks_);
  left_blocks_.erase(std::unique(left_blocks_.begin(), left_blocks_.end()), left_blocks_.end());
  std::erase_if(selected, [](const SelectedRows& s) { return s.rows.empty(); });
  return selected;
}

void DeltaSelection::learn_cost(Attribute attribute, std::size_t count, std::size_t bytes) {
  if (count < 32) return;
  for (std::size_t a = 0; a < layout_.attributes().size(); ++a) {
    if (layout_.attributes()[a].attribute != attribute) continue;
    const double seen = static_cast<double>(bytes) / static_cast<double>(count);
    bytes_per_entry_[a] += 0.5 * (seen - bytes_per_entry_[a]);
  }
}

}  // namespace splatbus::stream
