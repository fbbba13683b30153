#include "capture-bridge/round_plan.h"

#include <cmath>

#include "gaussians/light.h"

namespace splatbus::capture_bridge {

namespace {

/// The most cameras a surface whose samples are within the budget, or little above it: thinning evens out what several
/// cameras' grids leave, but a single camera's grid is more even than anything thinned.
int cameras_within_budget(std::span<const std::uint32_t, kRanks> of_rank, std::size_t budget) {
  const std::size_t most = budget + budget / 8;
  int cameras = 1;
  std::size_t samples = of_rank[1];
  for (std::size_t rank = 2; rank < kRanks && of_rank[rank] > 0; ++rank) {
    samples += of_rank[rank];
    if (samples > most) break;
    ++cameras;
  }
  return cameras;
}

}  // namespace

std::size_t settle_counts(std::span<const std::uint32_t, kRanks> of_rank, const SamplingOptions& options,
                          RoundCounts& counts) {
  counts.cameras_per_surface =
      options.cameras_per_surface > 0 ? options.cameras_per_surface : cameras_within_budget(of_rank, options.budget);
  const auto most = static_cast<std::size_t>(counts.cameras_per_surface);
  std::size_t survived = 0;
  counts.valid = 0;
  for (std::size_t rank = 1; rank < kRanks; ++rank) {
    counts.valid += of_rank[rank];
    if (rank <= most) survived += of_rank[rank];
  }
  counts.culled = counts.valid - survived;
  return survived;
}

float spacing_growth(std::size_t survived, std::size_t kept) {
  // The mean area that a kept sample stands for has grown by what thinning took away.
  return kept == 0 ? 1.0F : std::sqrt(static_cast<float>(survived) / static_cast<float>(kept));
}

HeightRanks height_ranks(std::size_t count) {
  const auto last = static_cast<double>(count - 1);
  return {static_cast<std::size_t>(0.02 * last), static_cast<std::size_t>(0.98 * last)};
}

const LinearTable& linear_table() {
  static const LinearTable table = [] {
    LinearTable values{};
    for (std::size_t i = 0; i < 256; ++i) values.value[i] = linear_from_srgb(static_cast<float>(i) / 255.0F);
    return values;
  }();
  return table;
}

}  // namespace splatbus::capture_bridge
