#pragma once

#include <cstddef>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "raster/rasterizer.h"
#include "trainer/model_slab.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// How well each grid cell is trained, for the expander's decision to freeze or thaw it. An estimate made to cost next
/// to nothing: after each step a few thousand Gaussians in turn look up the picture's error (mean |difference| over R,
/// G, B, display space) at the pixel that their mean projects to, if they contributed to the view. `loss` is the mean
/// over a cell's samples, newer ones weighing more; `movement` is the mean distance between a Gaussian's mean and its
/// average over time, in units of its largest standard deviation.
class CellStats {
 public:
  struct Cell {
    std::uint32_t count = 0;  ///< Gaussians in the cell
    float loss = 0, movement = 0;
    bool seen = false;  ///< sampled since the start
  };

  static constexpr std::size_t kSamplesAStep = 4096;

  /// The structure has changed: counts anew.
  void recount(const ModelPlanes& planes, std::size_t count);

  /// `display_space`: the render needs no sRGB curve. `contribution` as in raster::ParameterGradient.
  void observe(const ModelPlanes& planes, std::size_t count, const TrainingView& view, const raster::Image& color,
               bool display_space, const std::vector<float>& contribution);

  [[nodiscard]] const std::unordered_map<std::uint64_t, Cell>& cells() const { return cells_; }

 private:
  std::unordered_map<std::uint64_t, Cell> cells_;
  std::size_t next_ = 0;
};

}  // namespace splatbus::trainer
