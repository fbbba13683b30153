#include "relight/cuda/cuda_visibility.h"

#include <glm/gtc/quaternion.hpp>
#include <vector>

#include "device/buffer.h"
#include "device/stream.h"
#include "relight/cuda/visibility_kernel.h"

namespace splatbus::relight {

namespace {

cuda::Transform to_device(const Rigid& a_from_b) {
  const glm::mat3 rotation = glm::mat3_cast(a_from_b.rotation);
  cuda::Transform out{};
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) out.rotation[3 * row + column] = rotation[column][row];
    out.translation[row] = a_from_b.translation[row];
  }
  return out;
}

class CudaVisibility final : public VisibilityBackend {
 public:
  void compute(const GaussiansView& gaussians, const ObjectTransforms& objects, const LightDepthMap& map,
               const VisibilityOptions& options, float* visibility) override {
    std::vector<cuda::ObjectTransform> host_objects;
    host_objects.reserve(objects.size());
    for (const auto& [id, world_from_object] : objects) host_objects.push_back({id, to_device(world_from_object)});
    objects_.upload(host_objects.data(), host_objects.size(), stream_.get());
    const Camera& camera = map.camera;
    const cuda::SurfacePlanes surface{
        .count = gaussians.count,
        .stride = gaussians.stride,
        .surface_point = gaussians.surface_point,
        .normal = gaussians.normal,
        .log_scale = gaussians.parameters != nullptr ? gaussians.plane(ParameterLayout::kLogScale) : nullptr,
        .object_id = gaussians.object_id};
    const cuda::LightMap light{.width = static_cast<int>(camera.width),
                               .height = static_cast<int>(camera.height),
                               .fx = camera.fx,
                               .fy = camera.fy,
                               .cx = camera.cx,
                               .cy = camera.cy,
                               .light_from_world = to_device(inverse(camera.world_from_camera)),
                               .depth_m = map.depth_m};
    cuda::launch_visibility(surface, light, objects_.data(), static_cast<int>(host_objects.size()),
                            {options.softness_m, options.footprint, options.lift_texels}, visibility, stream_.get());
    stream_.wait();
  }

 private:
  device::Stream stream_;
  device::Buffer<cuda::ObjectTransform> objects_;
};

}  // namespace

std::unique_ptr<VisibilityBackend> make_cuda_visibility() {
  return std::make_unique<CudaVisibility>();
}

}  // namespace splatbus::relight
