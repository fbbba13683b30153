#include "viewer/gl/stage.h"

#include <algorithm>
#include <utility>

namespace splatbus::viewer::gl {
namespace {

Transform matrix_of(const ObjectTransform& transform) {
  const glm::mat3 rotation = glm::mat3_cast(transform.rigid.rotation);
  Transform out{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      out[static_cast<std::size_t>(4 * row + column)] = transform.scale * rotation[column][row];
    }
    out[static_cast<std::size_t>(4 * row + 3)] = transform.rigid.translation[row];
  }
  return out;
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

std::uint32_t Stage::far_field_of(const std::vector<std::uint32_t>& object_ids) const {
  const auto found = std::find(object_ids.begin(), object_ids.end(), kFarFieldFrame);
  return found != object_ids.end() ? static_cast<std::uint32_t>(found - object_ids.begin()) : 0;
}

void Stage::add(SharedBatch batch) {
  newest_object_ids_ = batch->object_ids;
  waiting_.push_back(batch);
  sorter_.add(std::move(batch));
}

void Stage::look(const Camera& camera, const SceneState& scene) {
  const Rigid view = inverse(camera.world_from_camera);
  const glm::vec3 z = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
  SortView now{.view_z = {z.x, z.y, z.z, view.translation.z},
               .near_m = camera.near_m,
               .transforms = transforms_of(scene, newest_object_ids_),
               .far_field = far_field_of(newest_object_ids_)};
  if (looks_ > 0 && now == view_) return;
  ++looks_;
  view_ = now;
  sorter_.look(std::move(now));
}

bool Stage::swap() {
  if (!sorter_.take(sorted_)) return false;
  for (; applied_ < sorted_.batches; ++applied_) {
    const Batch& batch = *waiting_.front();
    if (batch.whole) {
      renderer_.rows().clear();
      renderer_.rows().set_harmonics(batch.harmonics);
    }
    renderer_.rows().apply(batch.update);
    renderer_.rows().recolor(batch.colors);
    object_ids_ = batch.object_ids;
    display_space_ = batch.display_space;
    if (batch.bounds) bounds_ = batch.bounds;
    waiting_.pop_front();
  }
  renderer_.set_order(sorted_.order);
  return true;
}

bool Stage::prepare(const Camera& camera, const SceneState& scene) {
  look(camera, scene);
  return swap();
}

void Stage::settle(const Camera& camera, const SceneState& scene) {
  look(camera, scene);
  sorter_.wait();
  swap();
}

Frame Stage::frame_of(const Camera& camera, const SceneState& scene, float time_s) const {
  return {.camera = camera,
          .transforms = transforms_of(scene, object_ids_),
          .far_field = far_field_of(object_ids_),
          .background = scene.light.background,
          .display_space = display_space_,
          .antialias = antialias_,
          .time_s = time_s};
}

void Stage::draw(const Camera& camera, const SceneState& scene, float time_s, GLuint framebuffer) {
  renderer_.draw(frame_of(camera, scene, time_s), framebuffer);
}

Picture Stage::capture(const Camera& camera, const SceneState& scene, float time_s) {
  return renderer_.capture(frame_of(camera, scene, time_s));
}

}  // namespace splatbus::viewer::gl
