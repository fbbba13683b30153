// How long visibility of a whole model takes, of the sun alone and with 16 point lights, beside what its bytes take at
// the speed of a copy.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <span>
#include <string>
#include <vector>

#include "device/buffer.h"
#include "relight/visibility.h"

namespace splatbus::relight {

namespace {

struct Options {
  std::size_t gaussians = 1'000'000;
  std::uint32_t texels = 1024;
  int repeats = 20;
  int lamps = 16;
  Device device = Device::Cpu;
};

constexpr float kSide_m = 10, kBallRadius_m = 0.35F, kBallHeight_m = 0.6F;
constexpr int kBalls = 9;  // across, a metre apart
constexpr int kLamps = 4;  // across
constexpr std::uint32_t kLampTexels = 256;

/// To the nearest ball or to the floor, along a ray whose direction has any length, in lengths of it; `far` for
/// neither.
float hit(const glm::vec3& from, const glm::vec3& direction, float far) {
  float nearest = direction.y < 0 ? std::min(far, -from.y / direction.y) : far;
  const float length2 = glm::dot(direction, direction);
  for (int ball = 0; ball < kBalls * kBalls; ++ball) {
    const glm::vec3 centre(static_cast<float>(ball % kBalls - kBalls / 2), kBallHeight_m,
                           static_cast<float>(ball / kBalls - kBalls / 2));
    const glm::vec3 to = centre - from;
    const float middle = glm::dot(to, direction) / length2;
    const float reach = kBallRadius_m * kBallRadius_m - glm::dot(to, to) + middle * middle * length2;
    if (reach <= 0) continue;
    const float entry = middle - std::sqrt(reach / length2);
    if (entry > 0) nearest = std::min(nearest, entry);
  }
  return nearest;
}

struct HostMap {
  Camera camera;
  std::vector<float> depth_m;

  HostMap(const Camera& of, bool pinhole) : camera(of), depth_m(std::size_t{of.width} * of.height) {
    for (std::uint32_t y = 0; y < camera.height; ++y) {
      for (std::uint32_t x = 0; x < camera.width; ++x) {
        const glm::vec3 texel((static_cast<float>(x) + 0.5F - camera.cx) / camera.fx,
                              (static_cast<float>(y) + 0.5F - camera.cy) / camera.fy, pinhole ? 1 : 0);
        const Rigid& pose = camera.world_from_camera;
        depth_m[std::size_t{y} * camera.width + x] =
            pinhole ? hit(pose.translation, pose.rotation * texel, camera.far_m)
                    : hit(pose * texel, pose.rotation * glm::vec3(0, 0, 1), camera.far_m);
      }
    }
  }
};

/// A floor of 10 m under a grid of balls, Gaussians on the floor in rows, as many as asked for; the sun stands aslant,
/// and lamps hang between the balls.
struct Scene {
  GaussiansBuffer gaussians;
  std::vector<LightSource> sources;
  std::vector<std::vector<HostMap>> maps;

  explicit Scene(const Options& options) : gaussians(ParameterLayout{}, options.gaussians) {
    const auto across = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(options.gaussians))));
    const float step_m = kSide_m / static_cast<float>(across);
    const std::size_t stride = gaussians.stride();
    for (std::size_t i = 0; i < options.gaussians; ++i) {
      gaussians.surface_point[i] = (static_cast<float>(i % across) + 0.5F) * step_m - kSide_m / 2;
      gaussians.surface_point[2 * stride + i] = (static_cast<float>(i / across) + 0.5F) * step_m - kSide_m / 2;
      for (const std::size_t axis : {0, 2}) {
        gaussians.parameters[axis * stride + i] = gaussians.surface_point[axis * stride + i];
      }
      gaussians.normal[stride + i] = 1;
      for (std::size_t c = 0; c < 3; ++c) {
        gaussians.parameters[(ParameterLayout::kLogScale + c) * stride + i] = std::log(c == 1 ? 0.1F * step_m : step_m);
      }
    }
    Camera camera = look_at({6, 10, 4}, {0, 0, 0}, options.texels, options.texels, 1);
    camera.role = CameraRole::Light;
    camera.fx = camera.fy = static_cast<float>(options.texels) / 15.0F;
    sources.push_back({.kind = LightKind::Directional, .direction = glm::normalize(glm::vec3(6, 10, 4))});
    maps.push_back({HostMap(camera, false)});
    for (int lamp = 0; lamp < options.lamps; ++lamp) add_lamp(lamp);
  }

 private:
  void add_lamp(int lamp) {
    const glm::vec3 position(2.0F * static_cast<float>(lamp % kLamps) - 2.5F, 1.8F,
                             2.0F * static_cast<float>(lamp / kLamps) - 2.5F);
    sources.push_back({.id = static_cast<std::uint32_t>(lamp + 1), .position = position, .range_m = 4});
    const glm::quat down = glm::angleAxis(glm::half_pi<float>(), glm::vec3(1, 0, 0));
    std::vector<HostMap>& faces = maps.emplace_back();
    for (int face = 0; face < 6; ++face) {
      Camera camera{.role = CameraRole::Light, .width = kLampTexels, .height = kLampTexels, .far_m = 8};
      camera.fx = camera.fy = camera.cx = camera.cy = kLampTexels / 2.0F;
      const float angle = glm::half_pi<float>() * static_cast<float>(face);
      const glm::quat turn = glm::angleAxis(angle, glm::vec3(0, 1, 0));
      camera.world_from_camera = {.rotation = face < 4    ? turn
                                              : face == 4 ? down
                                                          : glm::conjugate(down),
                                  .translation = position};
      faces.emplace_back(camera, true);
    }
  }
};

/// Bytes a second of a copy that is much larger than any cache, of what it reads and writes together.
double copy_rate(const device::Stream& stream) {
  constexpr std::size_t kBytes = std::size_t{256} << 20;
  device::Buffer<std::uint8_t> from(stream, kBytes), to(stream, kBytes);
  from.clear();
  double least_s = 1e9;
  for (int k = 0; k < 5; ++k) {
    stream.view().wait();
    const auto begin = std::chrono::steady_clock::now();
    device::copy(stream, to.data(), from.data(), kBytes);
    stream.view().wait();
    least_s = std::min(least_s, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return 2.0 * kBytes / least_s;
}

void measure(const std::string& name, const Options& options, const device::Stream& stream, const GaussiansView& view,
             std::span<const MappedLight> lights, double bytes_a_second) {
  device::Buffer<std::uint8_t> visibility(stream, options.gaussians * lights.size());
  std::vector<double> samples_ms;
  for (int k = 0; k < options.repeats + 3; ++k) {
    const auto begin = std::chrono::steady_clock::now();
    compute_visibility(stream, view, {}, lights, {}, visibility.data());
    const std::chrono::duration<double, std::milli> spent = std::chrono::steady_clock::now() - begin;
    if (k >= 3) samples_ms.push_back(spent.count());
  }
  std::sort(samples_ms.begin(), samples_ms.end());
  std::size_t lit = 0, partly = 0;
  for (const std::uint8_t v : visibility.to_host()) {
    lit += v == 255 ? 1 : 0;
    partly += v > 0 && v < 255 ? 1 : 0;
  }
  // Three vectors of three floats in, a byte out for each light; the maps once.
  double bytes = static_cast<double>(options.gaussians) * (36 + static_cast<double>(lights.size()));
  for (const MappedLight& light : lights) {
    for (const LightDepthMap& map : light.maps) bytes += 4.0 * map.camera.width * map.camera.height;
  }
  const double share = 100.0 / static_cast<double>(visibility.size());
  fmt::print(
      "{} Gaussians, {}, {}: median {:.2f} ms, least {:.2f} ms; floor {:.3f} ms ({:.1f} MB at {:.0f} GB/s); {:.1f} % "
      "lit, {:.1f} % partly\n",
      options.gaussians, name, name_of(options.device), samples_ms[samples_ms.size() / 2], samples_ms.front(),
      1e3 * bytes / bytes_a_second, bytes / 1e6, bytes_a_second / 1e9, share * static_cast<double>(lit),
      share * static_cast<double>(partly));
}

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
             normal = placed(scene.gaussians.normal);
  std::vector<device::Buffer<float>> depths;
  std::vector<MappedLight> lights;
  for (std::size_t k = 0; k < scene.sources.size(); ++k) {
    MappedLight& light = lights.emplace_back(MappedLight{.source = scene.sources[k], .maps = {}});
    for (const HostMap& map : scene.maps[k]) {
      light.maps.push_back({.camera = map.camera, .depth_m = depths.emplace_back(placed(map.depth_m)).data()});
    }
  }
  GaussiansView view;
  view.count = options.gaussians;
  view.stride = scene.gaussians.stride();
  view.parameters = parameters.data();
  view.surface_point = point.data();
  view.normal = normal.data();
  const double rate = copy_rate(stream);
  measure("the sun", options, stream, view, std::span(lights).first(1), rate);
  if (options.lamps > 0) {
    measure(fmt::format("the sun and {} lights", options.lamps), options, stream, view, lights, rate);
  }
  return 0;
}

}  // namespace

}  // namespace splatbus::relight

int main(int argc, char** argv) {
  splatbus::relight::Options options;
  bool cuda = false;
  CLI::App app("Times relight's visibility of the sun, and of the sun and point lights.");
  app.add_option("--gaussians", options.gaussians)->capture_default_str();
  app.add_option("--texels", options.texels, "a side of the sun's depth map")->capture_default_str();
  app.add_option("--repeats", options.repeats)->capture_default_str();
  app.add_option("--lamps", options.lamps, "point lights with shadows")
      ->capture_default_str()
      ->check(CLI::Range(0, 32));
  app.add_flag("--cuda", cuda);
  CLI11_PARSE(app, argc, argv);
  if (cuda) options.device = splatbus::Device::Cuda;
  return splatbus::relight::run(options);
}
