#include "capture-bridge/cuda/warm_up.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace splatbus::capture_bridge::cuda {

namespace {

// Large enough for the algorithms that sorts and scans choose for large inputs.
constexpr std::size_t kLeastPixels = std::size_t{1} << 16;
constexpr std::size_t kMostPixels = std::size_t{1} << 20;

/// A wall two metres before the camera.
InputView wall(const Camera& camera, bus::MemoryPool& pool) {
  InputView view;
  view.camera = camera;
  bus::MemoryPool host_pool(Device::Cpu);
  InputView host = view;
  host.allocate(host_pool);
  for (std::uint32_t y = 0; y < camera.height; ++y) {
    for (std::uint32_t x = 0; x < camera.width; ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * camera.width + x;
      const glm::vec3 point = unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 2);
      host.position[i] = glm::vec4(point, 1);
      host.normal[i] = glm::vec4(0, 0, 1, 0);
      host.color[i] = host.albedo[i] = {128, 128, 128, 255};
    }
  }
  view.allocate(pool);
  view.copy_pictures(host);
  return view;
}

}  // namespace

void warm_up(Sampler& sampler, const RoundSizes& expected) {
  const std::size_t pixels = std::clamp(expected.views * expected.pixels, kLeastPixels, kMostPixels) / 2;
  const auto size = static_cast<std::uint32_t>(std::sqrt(static_cast<double>(pixels)));
  bus::MemoryPool pool(Device::Cuda);
  const InputView left = wall(look_at({-0.2F, 0, 2}, {-0.2F, 0, 0}, size, size, 1), pool);
  const InputView right = wall(look_at({0.2F, 0, 2}, {0.2F, 0, 0}, size, size, 1), pool);
  const std::vector<const InputView*> views{&left, &right};
  // Within the budget, and thinned.
  static_cast<void>(sampler.sample(views, {}, {.budget = pixels * 2, .cameras_per_surface = 2}));
  static_cast<void>(sampler.sample(views, {}, {.budget = pixels / 2, .cameras_per_surface = 2}));
}

}  // namespace splatbus::capture_bridge::cuda
