#pragma once

#include <cstdint>
#include <span>

#include "gaussians/camera.h"
#include "gaussians/model.h"
#include "raster/rasterizer.h"

namespace splatbus::bench {

/// What there is to do in one step on a batch of views, counted on the scene itself, apart from any backend: a record
/// is a Gaussian in a view, a pair a record in a tile. Fractions come from averages over several batches.
struct Census {
  double gaussians = 0, views = 0;
  double pixels = 0;             ///< of all views
  double listed_records = 0;     ///< records whose alpha reaches 1/255 in some pixel centre of the view
  double listed_gaussians = 0;   ///< Gaussians with such a record
  double pairs = 0;              ///< the same of tiles
  double evaluations = 0;        ///< pixels times the Gaussians that each blends until it is opaque
  double blended_records = 0;    ///< records that some pixel blends
  double blended_gaussians = 0;  ///< Gaussians with such a record
  double blended_pairs = 0;      ///< the same of tiles

  Census& operator+=(const Census& other);
  Census& operator/=(double divisor);
};

/// Blends all views with the rules of raster::Rasterizer, on all cores. Reads the parameters; all Gaussians are taken
/// to be static. `tile_side` in pixels.
[[nodiscard]] Census take_census(const GaussiansView& gaussians, std::span<const Camera> cameras,
                                 std::uint32_t tile_side, const raster::RenderOptions& options = {});

/// The mean over the batches that a benchmark goes through: the cameras in turn, until a batch begins with the first
/// one again.
[[nodiscard]] Census mean_census(const GaussiansView& gaussians, std::span<const Camera> cameras, std::size_t batch,
                                 std::uint32_t tile_side);

}  // namespace splatbus::bench
