#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "stream/codecs.h"
#include "stream/held_gaussians.h"
#include "stream/page_precision.h"

namespace splatbus::stream {

/// How much of the pictures each Gaussian makes up, an estimate without occlusion: opacity times the area in pixels of
/// its one-sigma ellipse's two largest axes, the largest over the viewers' cameras. Outside all pictures, and of an
/// object that is not there, a tenth of what it would be inside: viewers turn, objects come back. Without cameras the
/// area is in square centimetres. Of what is held, share[row] of the rows of `blocks` (of kBlockRows).
void picture_share(const HeldGaussians& gaussians, const StreamLayout& layout, std::span<const std::uint32_t> blocks,
                   std::span<const Camera> cameras, const ObjectTransforms& objects, std::span<float> share);
[[nodiscard]] std::vector<float> picture_share(const QuantizedGaussians& gaussians, const StreamLayout& layout,
                                               std::span<const Camera> cameras, const ObjectTransforms& objects);

/// When and how changes of one attribute are sent.
struct AttributeSchedule {
  std::int32_t dead_zone = 2;  ///< quantizer steps: only changes above it, in any channel, are sent
  std::uint32_t every = 1;     ///< ticks
  float weight = 1;            ///< of one step in the picture, against the other attributes
};

/// One schedule an attribute, by wire value; Visibility is sent otherwise, and Normal never changes.
using Schedules = std::array<AttributeSchedule, static_cast<std::size_t>(Attribute::MAX) + 1>;
[[nodiscard]] Schedules default_schedules();

/// What of one attribute is to be sent.
struct SelectedRows {
  Attribute attribute{};
  std::vector<std::uint32_t> rows;  ///< ascending
  std::vector<float> steps;         ///< [rows] that they are off, weighted by attribute
};

/// Chooses what of target - held is worth its bytes. Keeps, for each row and attribute, how long the target has rested:
/// what rested for `calm_ticks` is sent to within one step and then left alone, what still moves only beyond its dead
/// zone. A step is as coarse as the Gaussian's values may be: what is held is rounded so.
class DeltaSelection {
 public:
  DeltaSelection(const StreamLayout& layout, const Schedules& schedules, std::uint32_t calm_ticks = 8,
                 float coarseness = Precision::kLossless);

  void set_schedules(const Schedules& schedules) { schedules_ = schedules; }

  /// Follows the held state's rows.
  void resize(std::size_t rows);
  /// Another Gaussian is in the row.
  void begin(std::uint32_t row, const HeldGaussians& held);
  void move(std::uint32_t from, std::uint32_t to);

  /// Looks at the rows of `blocks`, which ascend, alone. `target_column[row]` is the row's column in `target`, or
  /// kNotHeld when nothing of it is to be sent. `share[row]` as picture_share. Stays near `budget_bytes` after
  /// compression, most picture for the byte first.
  [[nodiscard]] std::vector<SelectedRows> select(const HeldGaussians& held, const QuantizedGaussians& target,
                                                 std::span<const std::uint32_t> target_column,
                                                 std::span<const std::uint32_t> blocks, std::span<const float> share,
                                                 double budget_bytes);
  [[nodiscard]] double bytes_per_entry(Attribute attribute) const;
  /// Blocks, ascending, of which the last select() left something for later.
  [[nodiscard]] const std::vector<std::uint32_t>& left_blocks() const { return left_blocks_; }

  /// What a packet of `count` entries came to, for the next estimate.
  void learn_cost(Attribute attribute, std::size_t count, std::size_t bytes);

  /// Entries above their dead zone that the last select() left for later.
  [[nodiscard]] std::size_t pending() const { return left_; }

 private:
  struct Candidate {
    std::uint32_t bucket;  ///< of its score
    float steps;
    std::uint32_t row;
  };
  /// What one worker found in some of the blocks.
  struct Found {
    std::vector<std::vector<Candidate>> candidates;  ///< [attributes], by row
    std::vector<std::vector<std::uint32_t>> count;   ///< [attributes][buckets]
  };
  void classify(const QuantizedGaussians& target, std::span<const std::uint32_t> target_column,
                std::span<const std::uint32_t> blocks);
  void collect(std::uint32_t attribute, const HeldGaussians& held, const QuantizedGaussians& target,
               std::span<const std::uint32_t> target_column, std::span<const std::uint32_t> blocks,
               std::span<const float> share, Found& found);
  [[nodiscard]] bool is_due(std::uint32_t attribute) const;
  [[nodiscard]] const AttributeSchedule& schedule(std::uint32_t attribute) const;

  StreamLayout layout_;
  Schedules schedules_;
  std::uint32_t calm_ticks_;
  Precision precision_;
  std::uint64_t tick_ = 0;
  std::vector<std::vector<std::int32_t>> anchor_;  ///< [channels][rows] where the target rests
  std::vector<std::vector<std::uint8_t>> calm_;    ///< [attributes][rows] ticks of rest
  std::vector<double> bytes_per_entry_;            ///< [attributes]
  std::vector<Found> found_;                       ///< block after block
  std::vector<Precision::Class> classes_;          ///< [rows] of the target, of those that were looked at
  std::vector<std::uint32_t> left_blocks_;
  std::size_t left_ = 0;
};

}  // namespace splatbus::stream
