// How long the built-in engine takes for the pictures of a dome in the world, by what is asked of it, and what it
// draws.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <string>
#include <utility>
#include <vector>

#include "gl/context.h"
#include "gl/objects.h"
#include "sim/projection.h"
#include "sim/readback.h"
#include "sim/renderer.h"
#include "sim/snapshot.h"
#include "sim/world.h"

namespace splatbus::sim {

namespace {

struct Options {
  std::uint32_t size = 128;
  int cameras = 24;
  int places = 8;
  std::uint32_t seed = 0;
  RendererOptions renderer;
};

/// Leaves pictures where they are.
class NoReadback : public Readback {
 public:
  void begin(std::uint32_t /*width*/, std::uint32_t /*height*/, std::size_t /*bytes*/) override {}
  void take(const DrawnPicture& /*drawn*/) override {}
};

using Clock = std::chrono::steady_clock;

double milliseconds(Clock::duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

struct Cost {
  double submit_ms = 0, whole_ms = 0, thousand_triangles = 0;  ///< a picture
};

std::vector<splatbus_camera> dome(const Options& options, const glm::vec3& eye) {
  std::vector<splatbus_camera> cameras;
  for (int i = 0; i < options.cameras; ++i) {
    const float turn = glm::two_pi<float>() * static_cast<float>(i) / static_cast<float>(options.cameras);
    const float down = i % 3 == 0 ? -0.3F : 0.05F;
    splatbus_camera camera =
        look_at(eye, eye + glm::vec3(std::cos(turn), down, std::sin(turn)), options.size, options.size, 70);
    camera.far_m = 100;
    cameras.push_back(camera);
  }
  return cameras;
}

Cost measure(Renderer& renderer, const std::vector<std::vector<splatbus_camera>>& domes, std::uint32_t buffers) {
  NoReadback readback;
  const GlQuery drawn = make_query(GL_PRIMITIVES_GENERATED);
  Cost cost;
  double pictures = 0;
  for (int round = 0; round < 2; ++round) {  // the first warms up
    cost = {};
    pictures = 0;
    for (const auto& cameras : domes) {
      renderer.render(cameras.front(), buffers, readback);  // the shadows of the place
      glFinish();
      glBeginQuery(GL_PRIMITIVES_GENERATED, drawn.get());
      const auto begin = Clock::now();
      for (const splatbus_camera& camera : cameras) renderer.render(camera, buffers, readback);
      cost.submit_ms += milliseconds(Clock::now() - begin);
      glFinish();
      cost.whole_ms += milliseconds(Clock::now() - begin);
      glEndQuery(GL_PRIMITIVES_GENERATED);
      GLuint triangles = 0;
      glGetQueryObjectuiv(drawn.get(), GL_QUERY_RESULT, &triangles);
      cost.thousand_triangles += triangles / 1000.0;
      pictures += static_cast<double>(cameras.size());
    }
  }
  return {cost.submit_ms / pictures, cost.whole_ms / pictures, cost.thousand_triangles / pictures};
}

/// Of a picture, when places take turns and the sun's maps with them.
double shadow_milliseconds(Renderer& renderer, const std::vector<std::vector<splatbus_camera>>& domes) {
  NoReadback readback;
  const std::uint64_t before = renderer.shadow_maps_drawn();
  glFinish();
  const auto begin = Clock::now();
  for (int turn = 0; turn < 3; ++turn) {
    for (const auto& cameras : domes) renderer.render(cameras.front(), SPLATBUS_BUFFER_COLOR, readback);
  }
  glFinish();
  const auto maps = static_cast<double>(renderer.shadow_maps_drawn() - before);
  fmt::print("{} maps of the sun in {} pictures of {} places in turn\n", maps, 3 * domes.size(), domes.size());
  return milliseconds(Clock::now() - begin) / static_cast<double>(3 * domes.size());
}

void run(const Options& options) {
  auto context = std::make_shared<GlContext>();
  fmt::print("{}, {} cameras of {}x{} at each of {} places\n", context->description(), options.cameras, options.size,
             options.size, options.places);
  Scene scene = make_world(options.seed, false);
  scene.lighting.clouds = true;
  Renderer renderer(context, std::move(scene), options.renderer);
  const std::vector<glm::vec3> walk = world_walk(options.seed);
  std::vector<std::vector<splatbus_camera>> domes;
  for (int i = 0; i < options.places; ++i) {
    domes.push_back(
        dome(options, walk[walk.size() * static_cast<std::size_t>(i) / static_cast<std::size_t>(options.places)]));
  }
  constexpr std::uint32_t kGeometry =
      SPLATBUS_BUFFER_WORLD_POSITION | SPLATBUS_BUFFER_NORMAL | SPLATBUS_BUFFER_DEPTH | SPLATBUS_BUFFER_OBJECT_ID;
  constexpr std::uint32_t kShaded = SPLATBUS_BUFFER_COLOR | SPLATBUS_BUFFER_ALBEDO;
  fmt::print("{:<22} {:>10} {:>10} {:>16}\n", "a picture of", "submit ms", "whole ms", "1,000 triangles");
  for (const auto& [name, buffers] :
       {std::pair{"colour", std::uint32_t{SPLATBUS_BUFFER_COLOR}}, std::pair{"colour and albedo", kShaded},
        std::pair{"geometry", kGeometry}, std::pair{"depth", std::uint32_t{SPLATBUS_BUFFER_DEPTH}},
        std::pair{"everything", kShaded | kGeometry}}) {
    const Cost cost = measure(renderer, domes, buffers);
    fmt::print("{:<22} {:>10.3f} {:>10.3f} {:>16.1f}\n", name, cost.submit_ms, cost.whole_ms, cost.thousand_triangles);
  }
  fmt::print("{:<22} {:>10} {:>10.3f}\n", "colour, places in turn", "", shadow_milliseconds(renderer, domes));
}

}  // namespace

}  // namespace splatbus::sim

int main(int argc, char** argv) {
  CLI::App app("Times the built-in engine's pictures of its world.", "bench_engine");
  splatbus::sim::Options options;
  app.add_option("--size", options.size, "width and height of pictures, pixels")->capture_default_str();
  app.add_option("--cameras", options.cameras, "cameras of a place")->capture_default_str()->check(CLI::Range(1, 1000));
  app.add_option("--places", options.places, "places along the walk")->capture_default_str()->check(CLI::Range(1, 100));
  app.add_option("--seed", options.seed, "random seed of the world")->capture_default_str();
  app.add_option("--samples", options.renderer.samples, "coverage samples")->capture_default_str();
  app.add_option("--supersample", options.renderer.supersample, "shaded pixels a side of a pixel")
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  splatbus::sim::run(options);
  return 0;
}
