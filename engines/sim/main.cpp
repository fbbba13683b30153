#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <csignal>
#include <cstdlib>
#include <exception>
#include <functional>
#include <future>
#include <memory>
#include <stdexcept>

#include "bus/command_line.h"
#include "bus/log_sink.h"
#include "bus/parameter_json.h"
#include "sim/device_readback.h"
#include "sim/engine_loop.h"
#include "sim/field.h"
#include "sim/gltf_scene.h"
#include "sim/lamps.h"
#include "sim/light_control.h"
#include "sim/living_toys.h"
#include "sim/projection.h"
#include "sim/snapshot.h"
#include "sim/toys.h"
#include "sim/world.h"

namespace {

// NOLINTBEGIN(cppcoreguidelines-avoid-non-const-global-variables): set by a signal
std::atomic<bool> stop_requested = false;
std::atomic<int> stopped_by = 0;
// NOLINTEND(cppcoreguidelines-avoid-non-const-global-variables)

void request_stop(int signal) {
  stopped_by = signal;
  stop_requested = true;
}

void handle_signals() {
  struct sigaction action {};
  action.sa_handler = request_stop;
  action.sa_flags = static_cast<int>(SA_RESETHAND);  // a second one ends the process
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

struct Flags {
  std::string bus, name = "engine", scene = "toys", log_level = "info", backend = "auto";
  std::uint32_t seed = 1;
  bool dynamics = false, breathing = false, night = false, clouds = false;
  std::size_t point_lights = 0;
  splatbus::sim::Lighting lighting;
  splatbus::sim::RendererOptions renderer;
  splatbus::sim::EngineLoopOptions loop;
  std::string snapshot, pose, buffer = "color";
  splatbus::sim::GltfFrame gltf;
  std::uint32_t width = 512, height = 512;
  double time_s = 0;
  bool print_walk = false;
  bool only_check = false, json = false;
};

void add_flags(CLI::App& app, Flags& flags) {
  app.add_option("--bus", flags.bus, "bus address, ipc:///folder or tcp://host:port")->envname("SPLATBUS_BUS");
  app.add_option("--name", flags.name, "name on the bus, unique there")->capture_default_str();
  app.add_option("--scene", flags.scene,
                 "toys, world (a town of 224 m), field200 (posts and boxes on 200 m), or a glTF file (.glb, .gltf)")
      ->capture_default_str();
  app.add_option("--scale", flags.gltf.metres_a_unit, "metres per unit of the glTF file")
      ->capture_default_str()
      ->check(CLI::PositiveNumber);
  app.add_option("--up", flags.gltf.up, "up axis of the glTF file")
      ->capture_default_str()
      ->check(CLI::IsMember({"x", "-x", "y", "-y", "z", "-z"}));
  app.add_option("--seed", flags.seed, "random seed of the scene")->capture_default_str();
  app.add_flag("--dynamics", flags.dynamics,
               "move objects: they walk, bounce, turn, come and go (toys and world only)");
  app.add_flag("--breathing", flags.breathing, "add a toy that grows and shrinks (toys only)");
  app.add_option("--point-lights", flags.point_lights, "number of lamps that move over the toys (toys only)")
      ->capture_default_str()
      ->check(CLI::Range(std::size_t{0}, splatbus::sim::kLamps));
  app.add_flag("--clouds", flags.clouds, "show clouds and hills instead of a plain background (world always has them)");
  app.add_flag("--night", flags.night, "no sun and a faint sky");
  app.add_option("--sun-azimuth", flags.lighting.sun_azimuth_deg,
                 "sun's angle about the vertical, from +x towards +z, degrees")
      ->capture_default_str();
  app.add_option("--sun-zenith", flags.lighting.sun_zenith_deg, "sun's angle from the vertical, degrees")
      ->capture_default_str()
      ->check(CLI::Range(0, 90));
  app.add_option("--sun-rate", flags.lighting.sun_rate_deg_s,
                 "rate at which the sun turns about the vertical, degrees per second")
      ->capture_default_str();
  app.add_option("--fps", flags.loop.fps, "engine frames per second")
      ->capture_default_str()
      ->check(CLI::Range(0.1, 1000.0));
  app.add_option("--pictures-s", flags.loop.pictures_s,
                 "longest time for the pictures of one frame, s; the rest wait for the next")
      ->capture_default_str()
      ->check(CLI::Range(0.0, 1000.0));
  app.add_flag("--shared-clock", flags.loop.shared_clock,
               "count frames and time from the machine's start: engines of one scene, seed and --fps show the same");
  app.add_option("--frames", flags.loop.frames, "stop after this many frames; 0: never")->capture_default_str();
  app.add_option("--supersample", flags.renderer.supersample,
                 "shaded pixels per side of a pixel, each with coverage samples")
      ->capture_default_str()
      ->check(CLI::Range(1, 4));
  app.add_option("--backend", flags.backend,
                 "memory that frames are handed over in: cpu, cuda (rendered on the first CUDA device) or auto")
      ->envname("SPLATBUS_BACKEND")
      ->check(CLI::IsMember({"cpu", "cuda", "auto"}))
      ->capture_default_str();
  app.add_option("--log-level", flags.log_level, "trace, debug, info, warn, error or off")
      ->capture_default_str()
      ->check(CLI::IsMember({"trace", "debug", "info", "warn", "error", "off"}));
  app.add_option("--snapshot", flags.snapshot, "render one picture to this PNG file without a bus, and exit");
  app.add_option(
      "--pose", flags.pose,
      "pose of the snapshot: eye x,y,z, target x,y,z, vertical field of view in degrees; or fit, which shows the "
      "whole scene (default for glTF files)");
  app.add_option("--buffer", flags.buffer,
                 "buffer of the snapshot: color, albedo, normal, position, depth, id or light_depth")
      ->capture_default_str();
  app.add_option("--width", flags.width, "width of the snapshot, pixels")->capture_default_str();
  app.add_option("--height", flags.height, "height of the snapshot, pixels")->capture_default_str();
  app.add_flag("--print-walk", flags.print_walk,
               "print a walk through the world, an eye position 'x y z' in m per line, and exit");
  app.add_option("--time", flags.time_s, "engine time of the snapshot, s")->capture_default_str();
  app.add_flag("--parameters", flags.only_check, "check the options and exit; there are no parameters");
  app.add_flag("--json", flags.json, "with --parameters: print a line of JSON");
}

splatbus::sim::Scene make_scene(const Flags& flags) {
  using namespace splatbus::sim;
  const bool toys = flags.scene == "toys";
  Scene scene = toys                        ? make_toys(flags.seed, flags.dynamics)
                : flags.scene == "field200" ? make_field(flags.seed)
                : flags.scene == "world"    ? make_world(flags.seed, flags.dynamics)
                                            : load_gltf(flags.scene, {}, flags.gltf);
  scene.lighting = flags.lighting;
  scene.lighting.night = flags.night;
  scene.lighting.clouds = flags.clouds || flags.scene == "world";
  scene.lighting.sources_on = flags.point_lights;
  if (toys && flags.breathing) add_breathing_toy(scene);
  if (toys) add_lamps(scene);
  return scene;
}

/// How much it is, and where.
std::string description(const splatbus::sim::Scene& scene) {
  const splatbus::sim::Bounds bounds = scene.bounds(false);
  return fmt::format("{} triangles of {} textures from ({:.2f}, {:.2f}, {:.2f}) to ({:.2f}, {:.2f}, {:.2f}) m",
                     scene.triangle_count(), scene.images.size(), bounds.low.x, bounds.low.y, bounds.low.z,
                     bounds.high.x, bounds.high.y, bounds.high.z);
}

/// Where --pose says, or else where the scene shows well.
splatbus_camera snapshot_camera(const Flags& flags, const splatbus::sim::Scene& scene) {
  using namespace splatbus::sim;
  constexpr float kFov_deg = 60;
  const Bounds bounds = scene.bounds(false);
  const bool toys = flags.scene == "toys" || flags.scene == "field200";
  if (flags.pose == "fit" || (flags.pose.empty() && !toys && flags.scene != "world"))
    return fit_camera(bounds, flags.width, flags.height, kFov_deg);
  splatbus_camera camera =
      parse_pose(flags.pose.empty() ? "3.13,1.6,1.32,0,0.25,0,60" : flags.pose, flags.width, flags.height);
  if (flags.pose.empty() && flags.scene == "world") {
    const glm::vec3 eye = world_walk(flags.seed).front();
    camera = look_at(eye, {0, eye.y, 0}, flags.width, flags.height, kFov_deg);
  }
  reach(camera, bounds);
  return camera;
}

void print_walk(std::uint32_t seed) {
  fmt::print("# a walk of {} m through the world of seed {}: x y z of the eye, metres, y up\n", splatbus::sim::kWalk_m,
             seed);
  for (const glm::vec3& eye : splatbus::sim::world_walk(seed))
    fmt::print("{:.3f} {:.3f} {:.3f}\n", eye.x, eye.y, eye.z);
}

void run(const Flags& flags) {
  using namespace splatbus::sim;
  if (flags.print_walk) {
    if (flags.scene != "world") throw std::runtime_error("only the world has a walk: --scene world");
    print_walk(flags.seed);
    return;
  }
  // Beside each other: either takes a few tenths of a second, and two threads get more of a busy machine than one.
  std::future<Scene> making = std::async(std::launch::async, make_scene, std::cref(flags));
  const auto context = make_context(flags.snapshot.empty() ? flags.backend : "cpu");
  Scene scene = making.get();
  spdlog::info("{} objects, rendered by {}", scene.objects.size(), context->description());
  spdlog::info("{}", description(scene));
  Renderer renderer(context, std::move(scene), flags.renderer);
  if (!flags.snapshot.empty()) {
    renderer.set_time(flags.time_s);
    write_snapshot(renderer, snapshot_camera(flags, renderer.scene()), flags.buffer, flags.snapshot);
    return;
  }
  const std::unique_ptr<DeviceReadback> readback = make_device_readback(*context, flags.backend);
  renderer.warm_up(readback.get());
  const splatbus_memory memory = readback ? SPLATBUS_MEMORY_CUDA : SPLATBUS_MEMORY_HOST;
  const EngineHandle engine = open_engine(flags.bus, flags.name, memory);
  spdlog::info("frames in {} memory", readback ? "CUDA" : "host");
  LightControl control(flags.bus, flags.name);
  EngineLoopOptions options = flags.loop;
  options.before_frame = [&] {
    const LightChanges changes = control.take();
    if (changes.sun_azimuth_deg) renderer.turn_sun(*changes.sun_azimuth_deg);
    if (changes.night) renderer.set_night(*changes.night);
    if (changes.lamps_shown) renderer.show_lamps(*changes.lamps_shown);
    if (changes.point_lights) renderer.set_sources_on(*changes.point_lights);
  };
  EngineLoop(*engine, renderer, readback.get(), options).run(stop_requested);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("The built-in engine: renders a scene for the cameras that the bus asks for.", "splatbus-engine-sim");
  Flags flags;
  add_flags(app, flags);
  if (const auto status = splatbus::bus::parse_command_line(app, argc, argv)) return *status;
  if (flags.dynamics && flags.scene != "toys" && flags.scene != "world") {
    fmt::print(stderr, "splatbus-engine-sim: --dynamics is for the scenes toys and world, not '{}'\n", flags.scene);
    return splatbus::bus::kExitUsage;
  }
  if (flags.only_check) {
    if (flags.json) fmt::print("{}\n", splatbus::bus::to_json({}));
    return 0;
  }
  splatbus::bus::log_to_stderr(flags.name, flags.log_level);
  handle_signals();
  try {
    run(flags);
  } catch (const std::exception& error) {
    spdlog::critical("{}", error.what());
    return 1;
  }
  return splatbus::bus::exit_status_after(stopped_by);
}
