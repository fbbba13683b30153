#include "viewer/standalone.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "bus/error.h"
#include "bus/signals.h"
#include "viewer/viewer.h"

namespace splatbus::viewer {

int standalone_main(int argc, char** argv) {
  CLI::App app("Shows a stream without any bus", "splatbus-viewer");
  std::string endpoint, name = fmt::format("viewer-{}", ::getpid()), log_level = "info", backend = "auto";
  std::vector<std::string> changes;
  app.add_option("--connect", endpoint, "the streamer's endpoint, such as tcp://host:7600")->required();
  app.add_option("--name", name, "told to the streamer")->capture_default_str();
  app.add_option("--set", changes, "name=value of a parameter; repeatable")->allow_extra_args(false);
  app.add_option("--backend", backend, "what draws: cpu, cuda or auto")
      ->envname("SPLATBUS_BACKEND")
      ->check(CLI::IsMember({"cpu", "cuda", "auto"}))
      ->capture_default_str();
  app.add_option("--log-level", log_level, "trace, debug, info, warn, error or off")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    spdlog::set_level(spdlog::level::from_str(log_level));
    bus::Parameters parameters(bus::Parameters::declare<Options>());
    for (const std::string& change : changes) {
      const auto equals = change.find('=');
      if (equals == std::string::npos) throw bus::Error(fmt::format("--set '{}': expected name=value", change));
      const std::string problem = parameters.set(change.substr(0, equals), change.substr(equals + 1), false);
      if (!problem.empty()) throw bus::Error("--set: " + problem);
    }
    std::stop_source stop;
    const bus::StopSignals signals(stop);
    std::string detail;
    Viewer(parameters,
           {.name = name,
            .endpoint = endpoint,
            .device = bus::choose_backend(backend),
            .stop = stop.get_token(),
            .counter = [](const std::string& counter, double value) { spdlog::debug("{} {}", counter, value); },
            .detail =
                [&](const std::string& text) {
                  if (text != detail) spdlog::info("{}", text);
                  detail = text;
                }})
        .run();
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus-viewer: {}\n", error.what());
    return 1;
  }
  return 0;
}

}  // namespace splatbus::viewer
