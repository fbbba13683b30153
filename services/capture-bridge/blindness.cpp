#include "capture-bridge/blindness.h"

#include "capture-bridge/near_pixels.h"
#include "gaussians/portable.h"

namespace splatbus::capture_bridge {

bool BlindnessTest::is_blind(const InputView& view, float near_m) {
  const Rigid& stands = view.camera.world_from_camera;
  near_.clear();
  count_near(stream_.view(),
             {.position = reinterpret_cast<const float*>(view.position.data()),
              .object_id = view.object_id.data(),
              .width = view.camera.width,
              .height = view.camera.height,
              .eye = portable(stands.translation),
              .axis = portable(stands.rotation * glm::vec3(0, 0, 1))},
             near_m, near_.data());
  return 2 * std::size_t{near_.to_host().front()} > view.pixels();
}

}  // namespace splatbus::capture_bridge
