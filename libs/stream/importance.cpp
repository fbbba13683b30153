#include "stream/importance.h"

#include <algorithm>
#include <cmath>

namespace splatbus::stream {

namespace {

constexpr float kMaxAreaPx2 = 400;  // a Gaussian right before the camera is not worth more than this
constexpr float kOutsideShare = 0.1F;
constexpr float kCentimetres2 = 1e4F;

struct View {
  Camera camera;
  Rigid camera_from_world;
};

float area_px2(const View& view, const glm::vec3& mean_world, float sigma2_m2) {
  const glm::vec3 p = view.camera_from_world * mean_world;
  const float depth = std::max(std::abs(p.z), view.camera.near_m);
  const float area = std::min(sigma2_m2 * view.camera.fx * view.camera.fy / (depth * depth), kMaxAreaPx2);
  const float margin = 3 * std::sqrt(area);
  const float x = view.camera.fx * p.x / depth + view.camera.cx, y = view.camera.fy * p.y / depth + view.camera.cy;
  const bool inside = p.z > view.camera.near_m && x > -margin && y > -margin &&
                      x < static_cast<float>(view.camera.width) + margin &&
                      y < static_cast<float>(view.camera.height) + margin;
  return inside ? area : kOutsideShare * area;
}

}  // namespace

std::vector<float> picture_share(const QuantisedGaussians& gaussians, const StreamLayout& layout,
                                 std::span<const Camera> cameras, const ObjectTransforms& objects) {
  std::vector<View> views;
  for (const Camera& camera : cameras) views.push_back({camera, inverse(camera.world_from_camera)});
  const AttributeChannels &mean = layout.at(Attribute::Mean), &scale = layout.at(Attribute::LogScale),
                          &opacity = layout.at(Attribute::Opacity);
  const auto value = [&](const AttributeChannels& a, int channel, std::size_t i) {
    return a.quantiser.offset + a.quantiser.step * static_cast<float>(gaussians.planes[a.first + channel][i]);
  };
  std::vector<float> share(gaussians.count());
  for (std::size_t i = 0; i < share.size(); ++i) {
    const float a = value(scale, 0, i), b = value(scale, 1, i), c = value(scale, 2, i);
    const float sigma2 = std::exp(std::min(a + b + c - std::min({a, b, c}), 10.0F));
    float area = views.empty() ? std::min(sigma2 * kCentimetres2, kMaxAreaPx2) : 0;
    glm::vec3 p(value(mean, 0, i), value(mean, 1, i), value(mean, 2, i));
    if (gaussians.object_id[i] != 0) {
      if (const auto object = objects.find(gaussians.object_id[i]); object != objects.end()) p = object->second * p;
    }
    for (const View& view : views) area = std::max(area, area_px2(view, p, sigma2));
    share[i] = area * value(opacity, 0, i);
  }
  return share;
}

}  // namespace splatbus::stream
