#pragma once

#include <span>
#include <vector>

#include "gaussians/model.h"
#include "raster/cuda/device_scene.h"
#include "raster/rasterizer.h"

namespace splatbus::raster::cuda {

/// One camera with the transforms and the light of its own instant.
struct SceneView {
  Camera camera;
  const SceneState* scene = nullptr;
  /// Under that scene, as GaussiansView's, on the device; null: the Gaussians' own.
  const std::uint8_t* visibility = nullptr;
  std::size_t visibility_stride = 0;  ///< elements from one light's row to the next
  std::uint32_t visibility_rows = 1;
  /// Pages with bounds that these hide, but for the far field's, are left out; on the device.
  FarthestSurfaces hidden_behind = {};
};

/// The small tables of a batch, in host memory, ready to be copied to the device.
struct ViewTables {
  std::vector<DeviceView> views;          ///< [batch]
  std::vector<ObjectView> object_views;   ///< [batch][object_count]
  std::vector<std::uint32_t> object_ids;  ///< id of each slot but 0, ascending
  std::vector<ShadingSource> sources;     ///< [batch][source_room]
  int object_count = 1, source_room = 0;
};

/// Folds cameras, object transforms and light together. Every view knows the union of the views' objects; one that its
/// own scene lacks is hidden there. Throws std::invalid_argument when there are too many.
[[nodiscard]] ViewTables make_view_tables(std::span<const SceneView> views, Appearance appearance);

/// The same for objects chosen by the caller, ids ascending, and room for as many light sources a view as any has, or
/// more; an object that is none of them is hidden.
[[nodiscard]] ViewTables make_view_tables(std::span<const SceneView> views, Appearance appearance,
                                          std::vector<std::uint32_t> object_ids, int source_room);

/// Ids of the objects that any of the views moves, ascending. Throws std::invalid_argument when there are too many.
[[nodiscard]] std::vector<std::uint32_t> moving_objects(std::span<const SceneView> views);

/// The most light sources that shading needs of a view; 0 for Radiance, whose colours have light in them.
[[nodiscard]] int max_sources(std::span<const SceneView> views, Appearance appearance);

}  // namespace splatbus::raster::cuda
