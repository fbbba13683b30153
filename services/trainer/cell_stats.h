#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "raster/rasterizer.h"
#include "trainer/model_slab.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// How well each grid cell is trained, for the expander's decision to freeze or thaw it: means over samples of its
/// Gaussians, newer ones weighing more.
class CellTable {
 public:
  struct Cell {
    std::uint32_t count = 0;  ///< Gaussians in the cell
    float loss = 0;           ///< mean |difference| over R, G, B of the picture, display space
    float movement = 0;  ///< mean distance of a Gaussian's mean from its average over time, in units of its largest
                         ///< standard deviation
    bool seen = false;   ///< sampled since the start
  };

  /// The structure has changed: counts anew, from the cell of each Gaussian.
  void recount(const std::uint64_t* cell, std::size_t count);
  /// The same from counts; cells that are not named are gone.
  void recount(std::span<const std::uint64_t> cells, std::span<const std::uint32_t> counts);

  /// Takes in `samples` samples of a cell by their means.
  void observe(std::uint64_t cell, std::size_t samples, float loss, float movement);

  [[nodiscard]] const std::unordered_map<std::uint64_t, Cell>& cells() const { return cells_; }

 private:
  void forget_empty();

  std::unordered_map<std::uint64_t, Cell> cells_;
};

/// Samples for a CellTable that cost next to nothing: after each step a few thousand Gaussians in turn look up the
/// picture's error at the pixel that their mean projects to, if they contributed to the view.
class CellSampler {
 public:
  static constexpr std::size_t kSamplesAStep = 4096;
  static constexpr float kMinContribution = 1.0F / 32;  ///< below it another surface is what the pixel shows

  /// `display_space`: the render needs no sRGB curve. `contribution` as in raster::ParameterGradient. Host memory.
  void observe(const ModelPlanes& planes, std::size_t count, const TrainingView& view, const raster::Image& color,
               bool display_space, const std::vector<float>& contribution, CellTable& cells);

 private:
  std::size_t next_ = 0;
};

}  // namespace splatbus::trainer
