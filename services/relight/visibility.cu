#include <vector>

#include "device/buffer.h"
#include "device/parallel.h"
#include "relight/filter.h"
#include "relight/visibility.h"

namespace splatbus::relight {

namespace {

using math::Vec3;

constexpr float kMaxSlope = 8.0F;     // metres of depth a metre across: beyond it the normal is no guide
constexpr float kMinFacing = 0.02F;   // cosine below which no light arrives
constexpr float kMaxDeviation_m = 1;  // of a Gaussian
// A paraboloid has the spread of a uniform disc that is smaller by this.
constexpr float kParaboloidOverDisc = 1.2247449F;

struct MovingObject {
  std::uint32_t id = 0;
  math::Rigid world_from_object;
};

math::Rigid portable(const Rigid& rigid) {
  const glm::quat& q = rigid.rotation;
  return {math::rotation_matrix(q.w, q.x, q.y, q.z), {rigid.translation.x, rigid.translation.y, rigid.translation.z}};
}

/// Tests one Gaussian.
struct VisibilityTest {
  GaussiansView gaussians;
  const MovingObject* objects;  ///< by ascending id
  std::uint32_t object_count;
  const std::uint32_t* frame_of_page;  ///< null without pages
  math::Rigid light_from_world;
  float fx, fy, cx, cy;  ///< texels a metre, texels
  int width, height;
  const float* depth_m;
  VisibilityOptions options;
  std::uint8_t* visibility;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    Vec3 point = vector_at(gaussians.surface_point, i);
    Vec3 normal = vector_at(gaussians.normal, i);
    if (const MovingObject* object = moving_object(frame_of(i))) {
      point = transformed(object->world_from_object, point);
      normal = object->world_from_object.rotation * normal;
    }
    visibility[i] = static_cast<std::uint8_t>(test(point, normal, i) * 255.0F + 0.5F);
  }

 private:
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Vec3 vector_at(const float* channels, std::uint32_t i) const {
    const float* const first = channels + gaussians.offset(i);
    return {first[0], first[gaussians.stride], first[2 * gaussians.stride]};
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t frame_of(std::uint32_t i) const {
    if (frame_of_page != nullptr) return frame_of_page[i >> gaussians.page_shift];
    return gaussians.object_id != nullptr ? gaussians.object_id[i] : kWorldFrame;
  }

  /// Null when the object stands where its frame is the world's.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER const MovingObject* moving_object(std::uint32_t id) const {
    std::uint32_t low = 0, high = object_count;
    while (low < high) {
      const std::uint32_t middle = (low + high) / 2;
      objects[middle].id < id ? low = middle + 1 : high = middle;
    }
    return low < object_count && objects[low].id == id ? objects + low : nullptr;
  }

  /// Mean of the two larger standard deviations: a flat Gaussian's extent on its surface.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float surface_deviation_m(std::uint32_t i) const {
    if (gaussians.parameters == nullptr) return 0;
    const float* const log_scale = gaussians.at(ParameterLayout::kLogScale, i);
    const float a = log_scale[0], b = log_scale[gaussians.stride], c = log_scale[2 * gaussians.stride];
    if (a + b + c != a + b + c) return kMaxDeviation_m;
    const float largest = math::larger(math::larger(a, b), c);
    const float middle = math::larger(math::smaller(a, b), math::smaller(math::larger(a, b), c));
    return math::smaller(0.5F * (expf(middle) + expf(largest)), kMaxDeviation_m);
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER static float bounded_radius(float texels) {
    return math::clamped(texels, kMinRadius_texels, kMaxRadius_texels);
  }

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float test(const Vec3& point_world, const Vec3& normal_world,
                                                    std::uint32_t i) const {
    const Vec3 normal = light_from_world.rotation * normal_world;
    const float facing = -normal.z;
    if (!(facing > kMinFacing)) return 0;
    const float texel_m = 1.0F / math::smaller(fx, fy);
    const Vec3 point = transformed(light_from_world, point_world + normal_world * (options.lift_texels * texel_m));
    float slope_x = normal.x / facing, slope_y = normal.y / facing;
    const float steepness = sqrtf(slope_x * slope_x + slope_y * slope_y);
    if (steepness > kMaxSlope) {
      slope_x *= kMaxSlope / steepness;
      slope_y *= kMaxSlope / steepness;
    }
    const float radius_m = kParaboloidOverDisc * (options.softness_m + options.footprint * surface_deviation_m(i));
    const FilterWindow window{fx * point.x + cx,
                              fy * point.y + cy,
                              point.z,
                              slope_x / fx,
                              slope_y / fy,
                              bounded_radius(radius_m * fx),
                              bounded_radius(radius_m * fy)};
    if (!math::is_finite(window.depth_m + window.x + window.y)) return 0;
    const bool apart = window.x + window.radius_x < 0 || window.y + window.radius_y < 0 ||
                       window.x - window.radius_x > static_cast<float>(width) ||
                       window.y - window.radius_y > static_cast<float>(height);
    if (apart) return 1;
#ifdef __CUDA_ARCH__
    return lit_share(window, depth_m, width, height);
#else
    return lit_share_on_host(window, depth_m, width, height);
#endif
  }
};

/// Empty without pages.
std::vector<std::uint32_t> frames_of_pages(const GaussiansView& gaussians) {
  std::vector<std::uint32_t> frames;
  if (!gaussians.has_pages() || gaussians.count == 0) return frames;
  frames.resize(((gaussians.count - 1) >> gaussians.page_shift) + 1, kWorldFrame);
  for (const IndexRange& range : gaussians.ranges) frames[range.first >> gaussians.page_shift] = range.frame_id;
  return frames;
}

}  // namespace

void compute_visibility(device::StreamView stream, const GaussiansView& gaussians, const ObjectTransforms& objects,
                        const LightDepthMap& map, const VisibilityOptions& options, std::uint8_t* visibility) {
  std::vector<MovingObject> moving;
  moving.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) moving.push_back({id, portable(world_from_object.rigid)});
  const std::vector<std::uint32_t> frames = frames_of_pages(gaussians);
  device::Buffer<MovingObject> object_table(stream);
  object_table.assign(moving);
  device::Buffer<std::uint32_t> frame_table(stream);
  frame_table.assign(frames);
  const Camera& camera = map.camera;
  const VisibilityTest test{.gaussians = gaussians,
                            .objects = object_table.data(),
                            .object_count = static_cast<std::uint32_t>(moving.size()),
                            .frame_of_page = frame_table.data(),
                            .light_from_world = portable(inverse(camera.world_from_camera)),
                            .fx = camera.fx,
                            .fy = camera.fy,
                            .cx = camera.cx,
                            .cy = camera.cy,
                            .width = static_cast<int>(camera.width),
                            .height = static_cast<int>(camera.height),
                            .depth_m = map.depth_m,
                            .options = options,
                            .visibility = visibility};
  device::for_each_index(stream, static_cast<std::uint32_t>(gaussians.count), test);
  stream.wait();
}

}  // namespace splatbus::relight
