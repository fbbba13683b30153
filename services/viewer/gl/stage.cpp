#include "viewer/gl/stage.h"

#include <algorithm>

namespace splatbus::viewer::gl {
namespace {

Transform matrix_of(const ObjectTransform& transform) {
  const glm::mat3 rotation = glm::mat3_cast(transform.rigid.rotation);
  Transform out{};
  auto to = out.begin();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) *to++ = transform.scale * rotation[column][row];
    *to++ = transform.rigid.translation[row];
  }
  return out;
}

std::uint32_t far_field_of(const std::vector<std::uint32_t>& object_ids) {
  const auto found = std::find(object_ids.begin(), object_ids.end(), kFarFieldFrame);
  return found != object_ids.end() ? static_cast<std::uint32_t>(found - object_ids.begin()) : 0;
}

}  // namespace

std::vector<Transform> transforms_of(const SceneState& scene, const std::vector<std::uint32_t>& object_ids) {
  std::vector<Transform> transforms(object_ids.size());
  for (std::size_t k = 0; k < object_ids.size(); ++k) {
    const auto found = scene.objects.find(object_ids[k]);
    if (object_ids[k] == kWorldFrame) {
      transforms[k] = matrix_of({});
    } else if (found != scene.objects.end()) {
      transforms[k] = matrix_of(seen_from(glm::vec3(0), object_ids[k], found->second));
    }
  }
  return transforms;
}

void Stage::add(const Batch& batch) {
  RowStore& rows = renderer_.rows();
  if (batch.whole) rows.clear();
  rows.apply(batch.update);
  if (batch.whole) colors_.restart(batch.colors_ns);
  colors_.wrote(batch.update.rows);
  colors_.add(batch.colors, batch.colors_ns, batch.scene_ns);
  if (shown_ns_ == 0) colors_.advance(0, rows);
  object_ids_ = batch.object_ids;
  display_space_ = batch.display_space;
  if (batch.bounds) bounds_ = batch.bounds;
}

void Stage::advance(std::int64_t shown_ns) {
  shown_ns_ = shown_ns;
  colors_.advance(shown_ns, renderer_.rows());
}

Frame Stage::frame_of(const Camera& camera, const SceneState& scene, float time_s) const {
  return {.camera = camera,
          .transforms = transforms_of(scene, object_ids_),
          .far_field = far_field_of(object_ids_),
          .background = scene.light.background,
          .display_space = display_space_,
          .antialias = antialias_,
          .time_s = time_s,
          .color_part = colors_.part()};
}

void Stage::draw(const Camera& camera, const SceneState& scene, float time_s, GLuint framebuffer) {
  Frame frame = frame_of(camera, scene, time_s);
  frame.resolution = resolution_;
  renderer_.draw(frame, framebuffer);
}

Picture Stage::capture(const Camera& camera, const SceneState& scene, float time_s) {
  return renderer_.capture(frame_of(camera, scene, time_s));
}

}  // namespace splatbus::viewer::gl
