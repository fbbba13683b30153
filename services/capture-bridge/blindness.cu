#include "capture-bridge/blindness.h"
#include "device/parallel.h"
#include "gaussians/portable.h"

namespace splatbus::capture_bridge {

namespace {

/// A row of pixels an item.
struct CountNear {
  const float* position;
  const std::uint32_t* object_id;
  math::Vec3 eye, axis;
  float near_m;
  std::uint32_t width;
  std::uint32_t* count;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t row) const {
    std::uint32_t near = 0;
    for (std::uint32_t i = row * width; i < (row + 1) * width; ++i) {
      if (object_id[i] != 0 && dot(axis, math::load4(position, i).xyz - eye) < near_m) ++near;
    }
    device::atomic_add(count, near);
  }
};

}  // namespace

bool BlindnessTest::is_blind(const InputView& view, float near_m) {
  const Rigid& stands = view.camera.world_from_camera;
  near_.clear();
  device::for_each_index(stream_.view(), view.camera.height,
                         CountNear{.position = reinterpret_cast<const float*>(view.position.data()),
                                   .object_id = view.object_id.data(),
                                   .eye = portable(stands.translation),
                                   .axis = portable(stands.rotation * glm::vec3(0, 0, 1)),
                                   .near_m = near_m,
                                   .width = view.camera.width,
                                   .count = near_.data()});
  return 2 * std::size_t{near_.to_host().front()} > view.pixels();
}

}  // namespace splatbus::capture_bridge
