#include "capture-bridge/pixel_views.h"

#include <fmt/format.h>

#include <stdexcept>

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kMostViews = 255;  // ranks are bytes
constexpr std::size_t kMostPixels = std::size_t{1} << 30;

Vec3 portable(const glm::vec3& v) {
  return {v.x, v.y, v.z};
}

Mat3 portable(const glm::quat& rotation) {
  const glm::mat3 columns = glm::mat3_cast(rotation);
  return {portable(columns[0]), portable(columns[1]), portable(columns[2])};
}

math::Rigid portable(const Rigid& rigid) {
  return {portable(rigid.rotation), portable(rigid.translation)};
}

PixelView portable(const InputView& view) {
  const Camera& camera = view.camera;
  const Mat3 world_from_camera = portable(camera.world_from_camera.rotation);
  return {.width = camera.width,
          .height = camera.height,
          .fx = camera.fx,
          .fy = camera.fy,
          .cx = camera.cx,
          .cy = camera.cy,
          .near_m = camera.near_m,
          .far_m = camera.far_m,
          .centre = portable(camera.world_from_camera.translation),
          .world_from_camera = world_from_camera,
          .camera_from_world = transposed(world_from_camera),
          .background = portable(view.light.background),
          .position = reinterpret_cast<const float*>(view.position.data()),
          .normal = reinterpret_cast<const float*>(view.normal.data()),
          .color = reinterpret_cast<const std::uint8_t*>(view.color.data()),
          .albedo = reinterpret_cast<const std::uint8_t*>(view.albedo.data())};
}

/// Appends the objects of a view that stand elsewhere in the round's frame.
void add_moved(const ObjectTransforms& view_objects, const ObjectTransforms& round_objects,
               std::vector<MovedObject>& moved) {
  for (const auto& [id, world_from_object] : view_objects) {
    const auto found = round_objects.find(id);
    if (found == round_objects.end() || found->second == world_from_object) continue;
    const Rigid round_from_view = found->second * inverse(world_from_object);
    moved.push_back({id, portable(round_from_view), portable(inverse(round_from_view))});
  }
}

}  // namespace

PixelViews pixel_views(Views views, const ObjectTransforms& round_objects) {
  if (views.size() > kMostViews) {
    throw std::runtime_error(fmt::format("{} input views; at most {} are sampled at once", views.size(), kMostViews));
  }
  PixelViews all;
  std::vector<std::size_t> first_moved;
  for (const InputView* view : views) {
    all.views.push_back(portable(*view));
    all.views.back().first_pixel = static_cast<std::uint32_t>(all.pixels);
    all.pixels += view->pixels();
    if (all.pixels > kMostPixels) {
      throw std::runtime_error(fmt::format("more than {} pixels in a round of input views", kMostPixels));
    }
    first_moved.push_back(all.moved.size());
    add_moved(view->objects, round_objects, all.moved);
    all.views.back().moved_count = static_cast<std::uint32_t>(all.moved.size() - first_moved.back());
  }
  for (std::size_t v = 0; v < views.size(); ++v) all.views[v].moved = all.moved.data() + first_moved[v];
  return all;
}

}  // namespace splatbus::capture_bridge
