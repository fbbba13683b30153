#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <vector>

#include "raster/rasterizer.h"
#include "trainer/model_store.h"
#include "trainer/options.h"

namespace splatbus::trainer {

/// Columns to remove: transparent, huge or not finite in an active channel; those younger than min_age_steps only when
/// they are not finite. `removed` of the result counts them.
struct Pruning {
  std::vector<std::uint8_t> mask;  ///< 1: to remove
  std::size_t removed = 0;
  bool not_finite = false;
};
[[nodiscard]] Pruning find_prunable(const GaussiansView& gaussians, const PruneOptions& options, int active_channels,
                                    const std::vector<std::uint64_t>& created_step, std::uint64_t step);

/// How much smaller than a Gaussian the two are into which it is split (Kerbl et al. 2023).
inline constexpr float kSplitFactor = 1.6F;

/// Adaptive density control of 3DGS (Kerbl et al. 2023, section 5.2), off by default: the expander places Gaussians.
class Densifier {
 public:
  explicit Densifier(std::uint64_t seed) : random_(seed) {}

  /// Collects the gradients of the projected means.
  void observe(const raster::ParameterGradient& gradient);
  void resize(std::size_t count);
  void permute(const std::vector<std::uint32_t>& keep);

  /// Clones small and splits large Gaussians whose mean gradient is above the threshold, inside ModelStore::change(). A
  /// split leaves two in place of one, each drawn from it and 1.6 times smaller. Returns the columns added at the end.
  /// Forgets what was collected.
  ModelStore::Columns densify(ModelStore& store, const DensifyOptions& options);

 private:
  void sample_split(const ModelPlanes& planes, std::size_t column);

  std::vector<float> sum_;
  std::vector<std::uint32_t> steps_;  // that saw the Gaussian
  std::mt19937_64 random_;
};

}  // namespace splatbus::trainer
