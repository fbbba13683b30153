#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/census.h"
#include "bench/peaks.h"
#include "gaussians/layout.h"

namespace splatbus::bench {

/// One step of a benchmark, as far as the work in it goes.
struct Job {
  ParameterLayout layout;
  int active_channels = 0;  ///< trained; 0: all
  bool albedo = false;      ///< Transfer: an albedo picture, too
  bool fused = false;       ///< CPU: Adam within the backward pass
  Census census;
};

/// What one stage cannot do without, however it is built: bytes that have to come from memory or go there, each once,
/// and arithmetic operations on single floats, a fused multiply-add counting as one. docs/benchmarks.md derives them.
struct Floor {
  std::string stage;
  double bytes = 0, operations = 0;
};

/// The stages of raster::cuda::TrainStep::time_stages(). Sums over pixels are left out of the operations, for tensor
/// cores take them.
[[nodiscard]] std::vector<Floor> cuda_floors(const Job& job);
/// The stages of raster::Rasterizer::stage_times(), and what bench_raster adds to them.
[[nodiscard]] std::vector<Floor> cpu_floors(const Job& job);

/// For each stage of `measured` (name to milliseconds) that has a floor: bytes, operations, floor_ms, measured_ms,
/// times_floor, and bound, "memory" or "compute", the one that takes longer at the machine's best.
[[nodiscard]] nlohmann::json roofline(const std::vector<Floor>& floors, const Peaks& peaks,
                                      const nlohmann::json& measured);
/// Adds that for result["stages"], as "roofline", and what it comes from: "work" and "machine".
void add_roofline(const std::vector<Floor>& floors, const Peaks& peaks, const Census& census, nlohmann::json& result);
/// The same as lines for people.
[[nodiscard]] std::string roofline_table(const nlohmann::json& result);

}  // namespace splatbus::bench
