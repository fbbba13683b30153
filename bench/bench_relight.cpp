// How long the sun's visibility of a whole model takes, beside the least that its bytes take.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <vector>

#include "device/buffer.h"
#include "relight/visibility.h"

namespace splatbus::relight {

namespace {

struct Options {
  std::size_t gaussians = 1'000'000;
  std::uint32_t texels = 1024;
  int repeats = 20;
  Device device = Device::Cpu;
};

constexpr float kSide_m = 10, kBallRadius_m = 0.35F, kBallSpacing_m = 1;

/// A floor of 10 m under a grid of balls, Gaussians on the floor in rows, as many as asked for; the sun stands aslant.
struct Scene {
  GaussiansBuffer gaussians;
  Camera camera;
  std::vector<float> depth_m;

  explicit Scene(const Options& options) : gaussians(ParameterLayout{}, options.gaussians) {
    const auto across = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(options.gaussians))));
    const float step_m = kSide_m / static_cast<float>(across);
    const std::size_t stride = gaussians.stride();
    for (std::size_t i = 0; i < options.gaussians; ++i) {
      gaussians.surface_point[i] = (static_cast<float>(i % across) + 0.5F) * step_m - kSide_m / 2;
      gaussians.surface_point[2 * stride + i] = (static_cast<float>(i / across) + 0.5F) * step_m - kSide_m / 2;
      gaussians.normal[stride + i] = 1;
      for (std::size_t c = 0; c < 3; ++c) {
        gaussians.parameters[(ParameterLayout::kLogScale + c) * stride + i] = std::log(c == 1 ? 0.1F * step_m : step_m);
      }
    }
    camera = look_at({6, 10, 4}, {0, 0, 0}, options.texels, options.texels, 1);
    camera.role = CameraRole::Light;
    camera.fx = camera.fy = static_cast<float>(options.texels) / 15.0F;
    depth_m.resize(std::size_t{options.texels} * options.texels);
    const glm::vec3 along = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
    for (std::uint32_t y = 0; y < options.texels; ++y) {
      for (std::uint32_t x = 0; x < options.texels; ++x) {
        const glm::vec3 from = unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 0.0F);
        depth_m[std::size_t{y} * options.texels + x] = hit_m(from, along);
      }
    }
  }

  /// To the nearest ball, 0.6 m above the floor, or to the floor.
  static float hit_m(const glm::vec3& from, const glm::vec3& along) {
    float nearest = -from.y / along.y;
    for (float z = -4; z <= 4; z += kBallSpacing_m) {
      for (float x = -4; x <= 4; x += kBallSpacing_m) {
        const glm::vec3 to = glm::vec3(x, 0.6F, z) - from;
        const float middle = glm::dot(to, along), off2 = glm::dot(to, to) - middle * middle;
        if (off2 < kBallRadius_m * kBallRadius_m) {
          nearest = std::min(nearest, middle - std::sqrt(kBallRadius_m * kBallRadius_m - off2));
        }
      }
    }
    return nearest;
  }
};

int run(const Options& options) {
  const Scene scene(options);
  const device::Stream stream(options.device);
  const auto placed = [&](const std::vector<float>& values) {
    device::Buffer<float> buffer(stream);
    buffer.assign(std::span(values));
    stream.view().wait();
    return buffer;
  };
  const auto parameters = placed(scene.gaussians.parameters), point = placed(scene.gaussians.surface_point),
             normal = placed(scene.gaussians.normal), depth_m = placed(scene.depth_m);
  device::Buffer<std::uint8_t> visibility(stream, options.gaussians);
  GaussiansView view;
  view.count = options.gaussians;
  view.stride = scene.gaussians.stride();
  view.parameters = parameters.data();
  view.surface_point = point.data();
  view.normal = normal.data();
  std::vector<double> samples_ms;
  for (int k = 0; k < options.repeats + 3; ++k) {
    const auto begin = std::chrono::steady_clock::now();
    compute_visibility(stream, view, {}, {.camera = scene.camera, .depth_m = depth_m.data()}, {}, visibility.data());
    const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - begin;
    if (k >= 3) samples_ms.push_back(spent.count());
  }
  std::sort(samples_ms.begin(), samples_ms.end());
  std::size_t lit = 0, partly = 0;
  for (const std::uint8_t v : visibility.to_host()) {
    lit += v == 255 ? 1 : 0;
    partly += v > 0 && v < 255 ? 1 : 0;
  }
  // Three vectors of three floats in, a byte out; the map once.
  const double bytes = static_cast<double>(options.gaussians) * 37 + static_cast<double>(depth_m.bytes());
  fmt::print(
      "{} Gaussians, {}^2 texels, {}: median {:.2f} ms, least {:.2f} ms; {:.1f} MB; {:.1f} % lit, {:.1f} % partly\n",
      options.gaussians, options.texels, name_of(options.device), samples_ms[samples_ms.size() / 2], samples_ms.front(),
      bytes / 1e6, 100.0 * static_cast<double>(lit) / static_cast<double>(options.gaussians),
      100.0 * static_cast<double>(partly) / static_cast<double>(options.gaussians));
  return 0;
}

}  // namespace

}  // namespace splatbus::relight

int main(int argc, char** argv) {
  splatbus::relight::Options options;
  bool cuda = false;
  CLI::App app("Times relight's visibility of one light.");
  app.add_option("--gaussians", options.gaussians)->capture_default_str();
  app.add_option("--texels", options.texels, "a side of the light's depth map")->capture_default_str();
  app.add_option("--repeats", options.repeats)->capture_default_str();
  app.add_flag("--cuda", cuda);
  CLI11_PARSE(app, argc, argv);
  if (cuda) options.device = splatbus::Device::Cuda;
  return splatbus::relight::run(options);
}
