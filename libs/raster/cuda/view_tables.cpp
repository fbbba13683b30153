#include "raster/cuda/view_tables.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>

namespace splatbus::raster::cuda {
namespace {

DeviceView device_view(const SceneView& of, Appearance appearance) {
  const Camera& camera = of.camera;
  const Light& light = of.scene->light;
  DeviceView view{};
  view.visibility = of.visibility;
  view.hidden_behind = of.hidden_behind;
  view.fx = camera.fx;
  view.fy = camera.fy;
  view.cx = camera.cx;
  view.cy = camera.cy;
  view.near_m = camera.near_m;
  const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  // 3DGS's clamp, for any principal point: 0.3 of the half field of view beyond each border (as gsplat).
  const float margin_x = 0.3F * 0.5F * width / camera.fx, margin_y = 0.3F * 0.5F * height / camera.fy;
  view.limit_x_low = -camera.cx / camera.fx - margin_x;
  view.limit_x_high = (width - camera.cx) / camera.fx + margin_x;
  view.limit_y_low = -camera.cy / camera.fy - margin_y;
  view.limit_y_high = (height - camera.cy) / camera.fy + margin_y;
  for (int c = 0; c < 3; ++c) {
    view.background[c] =
        appearance == Appearance::Transfer ? light.background[c] : srgb_from_linear(light.background[c]);
  }
  return view;
}

/// `light` without its sources.
ObjectView object_view(const Camera& camera, const Light& light, const ObjectTransform& object, int source_count) {
  ObjectView out{};
  out.scale = object.scale;
  out.source_count = object.emissive ? 0 : source_count;
  const Rigid view_from_object = inverse(camera.world_from_camera) * object.rigid;
  const glm::mat3 rotation = glm::mat3_cast(view_from_object.rotation);
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      out.view_from_object[4 * row + column] = object.scale * rotation[column][row];
    }
    out.view_from_object[4 * row + 3] = view_from_object.translation[row];
  }
  const glm::vec3 eye = object_point(object, camera.world_from_camera.translation);
  const Light local = light_in_object(light, object);
  for (int c = 0; c < 3; ++c) {
    out.camera_in_object[c] = eye[c];
    out.sun_direction[c] = local.sun_direction[c];
    out.sun_irradiance[c] = local.sun_irradiance[c];
    for (std::size_t k = 0; k < 9; ++k) out.ambient_sh[3 * k + static_cast<std::size_t>(c)] = local.ambient_sh[k][c];
  }
  return out;
}

}  // namespace

std::vector<std::uint32_t> moving_objects(std::span<const SceneView> views) {
  std::set<std::uint32_t> ids;
  for (const SceneView& view : views) {
    for (const auto& [id, transform] : view.scene->objects) ids.insert(id);
  }
  ids.erase(kWorldFrame);  // which nothing moves
  if (ids.size() >= static_cast<std::size_t>(kMaxObjects)) {
    throw std::invalid_argument("CUDA rasteriser: more than " + std::to_string(kMaxObjects - 1) + " moving objects");
  }
  return {ids.begin(), ids.end()};
}

int max_sources(std::span<const SceneView> views, Appearance appearance) {
  std::size_t most = 0;
  if (appearance == Appearance::Transfer) {
    for (const SceneView& view : views) most = std::max(most, view.scene->light.sources.size());
  }
  return static_cast<int>(std::min(most, kMaxLightSources + 1));  // which shading_sources() refuses
}

ViewTables make_view_tables(std::span<const SceneView> views, Appearance appearance) {
  return make_view_tables(views, appearance, moving_objects(views), max_sources(views, appearance));
}

ViewTables make_view_tables(std::span<const SceneView> views, Appearance appearance,
                            std::vector<std::uint32_t> object_ids, int source_room) {
  ViewTables tables;
  tables.source_room = source_room;
  tables.object_ids = std::move(object_ids);
  tables.object_count = 1 + static_cast<int>(tables.object_ids.size());
  for (const SceneView& view : views) {
    tables.views.push_back(device_view(view, appearance));
    Light light = view.scene->light;
    int source_count = 0;
    if (source_room > 0) {
      const std::vector<ShadingSource> sources =
          shading_sources(light, inverse(view.camera.world_from_camera),
                          {view.visibility, view.visibility_stride, view.visibility_rows});
      source_count = static_cast<int>(sources.size());
      tables.sources.insert(tables.sources.end(), sources.begin(), sources.end());
      tables.sources.resize(tables.views.size() * static_cast<std::size_t>(source_room));
    }
    light.sources.clear();  // which are in the table
    tables.object_views.push_back(object_view(view.camera, light, Rigid{}, source_count));
    for (const std::uint32_t id : tables.object_ids) {
      const auto found = view.scene->objects.find(id);
      tables.object_views.push_back(
          found == view.scene->objects.end()
              ? hidden_object()
              : object_view(view.camera, light, seen_from(view.camera.world_from_camera.translation, id, found->second),
                            source_count));
    }
  }
  return tables;
}

}  // namespace splatbus::raster::cuda
