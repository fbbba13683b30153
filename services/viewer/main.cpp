#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <exception>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "bus/clock.h"
#include "bus/command_line.h"
#include "bus/error.h"
#include "bus/log_sink.h"
#include "bus/service.h"
#include "bus/shorthand.h"
#include "gl/context.h"
#include "stream/streamer_choice.h"
#include "viewer/gl/flight.h"
#include "viewer/replay.h"
#include "viewer/succession.h"
#include "viewer/viewer.h"

namespace {

const std::vector<splatbus::bus::Shorthand> kShorthands{
    {"--window", "window=true", "show a window (short for --set window=true)"},
    {"--probe", "probe=true", "compare pictures with the engine's (short for --set probe=true)"},
    {"--record", "packet_log=", "file for the packets that come (short for --set packet_log=FILE)"},
    {"--backend gl", "opengl=true", "draw with OpenGL (short for --set opengl=true)"}};
/// Of one without a bus: of one on a bus they are the bus's.
const std::vector<splatbus::bus::Shorthand> kDoors{
    {"--key", "key=", "key file for a streamer on another machine, made by 'splatbus keys' (default: SPLATBUS_KEY)"},
    {"--server-key", "server_key=", "public key of that streamer (default: SPLATBUS_SERVER_KEY)"},
    {"--token", "token=", "token for a gateway (default: the one in the address, or SPLATBUS_TOKEN)"},
    {"--ca",
     "ca=", "PEM file of the authority that signed the gateway's certificate (default: those the system trusts)"}};
const std::vector<splatbus::bus::OwnFlag> kWithoutABus{
    {"--connect", "ADDRESS", "show a streamer or gateway elsewhere, without a bus; with --help after it: its options"},
    {"--replay", "FILE", "play a packet log, without a bus"},
    {"--bench", "SECONDS", "measure a fixed flight through OpenGL, without a bus or a window"}};

void run_on_bus(splatbus::bus::ServiceContext& service) {
  std::string endpoint = service.parameters.read<splatbus::viewer::Options>().endpoint;
  std::function<std::string()> find_endpoint;
  if (endpoint.empty()) {
    const auto finder = std::make_shared<splatbus::stream::StreamerFinder>(service.bus);
    find_endpoint = [finder] { return finder->endpoint(splatbus::bus::now_ns()); };
    const splatbus::bus::Address& address = service.bus->address();
    if (address.is_local()) {
      endpoint = "ipc://" + *address.directory + "/streamer";
    } else {
      service.detail("waits for a streamer");
      while ((endpoint = find_endpoint()).empty()) {
        if (service.stop.stop_requested()) return;
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
      }
    }
  }
  splatbus::viewer::Viewer viewer(
      service.parameters, {.name = service.bus->source(),
                           .endpoint = endpoint,
                           .find_endpoint = find_endpoint,
                           .device = service.backend,
                           .stop = service.stop,
                           .counter = [&](const std::string& name, double value) { service.counter(name, value); },
                           .detail = [&](const std::string& text) { service.detail(text); },
                           .place = splatbus::viewer::take_place(*service.bus)});
  viewer.run();
  // Who starts another one later begins where the parameters say.
  if (service.yields()) splatbus::viewer::leave_place(*service.bus, viewer.place());
}

/// A fixed flight through OpenGL without a window, and a line of JSON: how fast it was.
void bench(double seconds, std::size_t gaussians, double changing, const splatbus::viewer::Options& options) {
  namespace gl = splatbus::viewer::gl;
  const splatbus::GlContext context;
  gl::Stage stage(options.draw);
  const gl::SharedBatch floor = gl::wavy_floor(gaussians);
  stage.add(*floor);
  splatbus::SceneState scene;
  scene.light.background = glm::vec3(0.1F, 0.2F, 0.4F);
  const gl::FlightFigures f =
      gl::fly(stage, scene, *floor->bounds, options.path.width, options.path.height, seconds, {floor, changing});
  fmt::print(
      R"({{"gaussians": {}, "width": {}, "height": {}, "frames": {}, "seconds": {:.2f}, "frames_per_s": {:.1f}, )"
      R"("median_ms": {:.3f}, "p95_ms": {:.3f}, "p99_ms": {:.3f}, )",
      gaussians, options.path.width, options.path.height, f.frames, f.seconds, f.frames_per_s, f.median_ms, f.p95_ms,
      f.p99_ms);
  fmt::print(R"("rows_changed_per_s": {:.0f}, )", static_cast<double>(f.rows_changed) / seconds);
  fmt::print(
      R"("draw": "{}", "by_quads": {}, "by_tiles": {}, "without_room": {}, "pairs": {}, "trial_quads_ms": {:.3f}, )"
      R"("trial_tiles_ms": {:.3f}, )",
      f.drawn.by_tiles > f.drawn.by_quads ? "tiles" : "quads", f.drawn.by_quads, f.drawn.by_tiles, f.drawn.without_room,
      f.drawn.pairs, stage.choice().cost_ms(gl::Way::Quads), stage.choice().cost_ms(gl::Way::Tiles));
  fmt::print(
      R"("device_ms": {:.3f}, "device_project_ms": {:.3f}, "device_sort_ms": {:.3f}, "device_pairs_ms": {:.3f}, )"
      R"("device_tile_sort_ms": {:.3f}, "device_draw_ms": {:.3f}, "device_resolve_ms": {:.3f}, "device": "{}"}})"
      "\n",
      f.device.all_ms, f.device.project_ms, f.device.sort_ms, f.device.pairs_ms, f.device.tile_sort_ms,
      f.device.draw_ms, f.device.resolve_ms, context.description());
}

/// Logs what the viewer waits for: when that changes, and again every ten seconds as long as nobody answers.
void report_detail(const std::string& text, std::string& said, std::int64_t& said_ns) {
  constexpr std::int64_t kRepeatNs = 10'000'000'000;
  const std::int64_t now = splatbus::bus::now_ns();
  if (text == said && (!text.starts_with("waits for the streamer") || now - said_ns < kRepeatNs)) return;
  if (text == said) {
    spdlog::warn("{}: no answer; are the address, the key and the server's key right?", text);
  } else {
    spdlog::info("{}", text);
  }
  said = text;
  said_ns = now;
}

/// The viewer without a bus: --connect ENDPOINT, beside a streamer on another machine; --replay LOG; --bench SECONDS.
/// Returns the exit status.
int standalone_main(int argc, char** argv) {
  CLI::App app("Shows a stream without a bus", "splatbus-viewer");
  std::string endpoint, name = fmt::format("viewer-{}", ::getpid()), log_level = "info", backend = "auto";
  std::vector<std::string> settings, changes;
  std::string log;
  double bench_s = 0;
  std::size_t bench_gaussians = 1'000'000;
  double bench_changing = 0;
  auto* source = app.add_option_group("source", "What to show (exactly one)");
  source->add_option("--connect", endpoint,
                     "streamer's endpoint, such as tcp://host:7600, or gateway's address, such as wss://host:7680");
  source->add_option("--replay", log, "packet log written with --record");
  source->add_option("--bench", bench_s, "measure a fixed flight through OpenGL without a window for this many seconds")
      ->check(CLI::Range(0.1, 3600.0));
  source->require_option(1);
  app.add_option("--gaussians", bench_gaussians, "Gaussians of the flight of --bench")
      ->check(CLI::Range(std::size_t{1}, splatbus::stream::kMaxGaussians))
      ->capture_default_str();
  app.add_option("--changing", bench_changing, "Gaussians that change in each second of the flight of --bench")
      ->check(CLI::Range(0.0, 1e8))
      ->capture_default_str();
  app.add_option("--name", name, "name that the streamer is told")->capture_default_str();
  app.add_option("--set", changes, "set a parameter, name=value (repeatable)")->allow_extra_args(false);
  std::vector<splatbus::bus::Shorthand> flags = kShorthands;
  flags.insert(flags.end(), kDoors.begin(), kDoors.end());
  splatbus::bus::add_backend_and_shorthands(app, flags, backend, settings);
  app.add_option("--log-level", log_level, "trace, debug, info, warn, error or off")->capture_default_str();
  if (const auto status = splatbus::bus::parse_command_line(app, argc, argv)) return *status;
  try {
    splatbus::bus::log_to_stderr(name, log_level);
    splatbus::bus::Parameters parameters(splatbus::bus::Parameters::declare<splatbus::viewer::Options>());
    if (!endpoint.empty()) changes.push_back("endpoint=" + endpoint);
    settings.insert(settings.end(), changes.begin(), changes.end());
    for (const std::string& change : settings) {
      const auto equals = change.find('=');
      const std::string problem = equals == std::string::npos
                                      ? fmt::format("--set '{}': expected name=value", change)
                                      : parameters.set(change.substr(0, equals), change.substr(equals + 1), false);
      if (problem.empty()) continue;
      fmt::print(stderr, "splatbus-viewer: {}\n", problem);
      return splatbus::bus::kExitUsage;
    }
    std::stop_source stop;
    const splatbus::bus::StopSignals signals(stop);
    const auto options = parameters.read<splatbus::viewer::Options>();
    if (bench_s > 0) {
      bench(bench_s, bench_gaussians, bench_changing, options);
      return 0;
    }
    if (!log.empty()) {
      splatbus::viewer::replay(log, options, splatbus::bus::choose_backend(backend), stop.get_token());
      return 0;
    }
    std::string detail;
    std::int64_t said_ns = 0;
    splatbus::viewer::Viewer(
        parameters,
        {.name = name,
         .endpoint = endpoint,
         .device = splatbus::bus::choose_backend(backend),
         .stop = stop.get_token(),
         .counter = [](const std::string& counter, double value) { spdlog::debug("{} {}", counter, value); },
         .detail = [&](const std::string& text) { report_detail(text, detail, said_ns); }})
        .run();
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus-viewer: {}\n", error.what());
    return 1;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    for (const splatbus::bus::OwnFlag& own : kWithoutABus) {
      if (argument == own.flag || argument.starts_with(own.flag + "=")) return standalone_main(argc, argv);
    }
  }
  const splatbus::bus::ServiceDescription description{
      .kind = "viewer",
      .summary = "Shows the Gaussian model",
      .parameters = splatbus::bus::Parameters::declare<splatbus::viewer::Options>(),
      .shorthands = kShorthands,
      .own_flags = kWithoutABus,
  };
  return splatbus::bus::service_main(argc, argv, description, run_on_bus);
}
