#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "capture-bridge/culling_math.h"
#include "capture-bridge/sample_math.h"
#include "capture-bridge/surface.h"

namespace splatbus::capture_bridge {

struct SamplingOptions {
  SurfaceOptions surface{};
  CullOptions culling{};
  std::size_t budget = 60000;  ///< samples a round
  /// How many cameras keep their samples of the same surface, the best ones; 0: as many as the budget has room for.
  int cameras_per_surface = 0;
};

/// What is to be expected of a round.
struct RoundSizes {
  std::size_t views = 0;
  std::size_t pixels = 0;  ///< of each view
  std::size_t samples = 0;
};

/// How many samples a round had, and what became of them.
struct RoundCounts {
  std::vector<DropCounts> dropped;  ///< a view
  int cameras_per_surface = 0;      ///< what the budget had room for
  std::size_t valid = 0;            ///< samples before culling
  std::size_t culled = 0;           ///< samples that another camera sees better
  std::size_t thinned = 0;          ///< samples over the budget
};

/// Values of a rank, 0 (no sample) included.
constexpr std::size_t kRanks = 256;

/// Sets cameras_per_surface, valid and culled of a round of whose pixels of_rank[r] have rank r; returns how many
/// samples survive culling.
std::size_t settle_counts(std::span<const std::uint32_t, kRanks> of_rank, const SamplingOptions& options,
                          RoundCounts& counts);

/// By how much the distance between samples grows when `kept` of `survived` are kept.
[[nodiscard]] float spacing_growth(std::size_t survived, std::size_t kept);

/// Places of the lowest and the highest of the middle 96 % of `count` sorted heights; count is not 0.
struct HeightRanks {
  std::size_t low, high;
};
[[nodiscard]] HeightRanks height_ranks(std::size_t count);

[[nodiscard]] const LinearTable& linear_table();

}  // namespace splatbus::capture_bridge
