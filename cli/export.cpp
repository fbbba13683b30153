#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <stdexcept>

#include "gaussians/model.h"
#include "live_scene.h"
#include "schema_json.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

struct ExportOptions {
  std::string bus;
  std::string path;
  double timeout_s = 30;
  bool json = false;
};

int export_model(const ExportOptions& options) {
  const bus::Address address = bus_address(options.bus);
  LiveScene live(connect(address));
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.timeout_s * 1e9);
  while (bus::now_ns() < end_ns && (!live.published() || !live.has_scene())) {
    live.poll(std::chrono::milliseconds(50));
  }
  const auto model = live.copy_average(std::chrono::milliseconds(1000));
  if (!model) {
    throw std::runtime_error(
        fmt::format("no model/published within {} s on {}: is a trainer running?", options.timeout_s, address.text()));
  }
  if (model->layout().appearance == Appearance::Transfer && !live.has_scene()) {
    throw std::runtime_error(fmt::format("no scene/state within {} s on {}, which this model is shaded with",
                                         options.timeout_s, address.text()));
  }
  write_ply(options.path, model->view(), live.scene());
  if (options.json) {
    fmt::print("{}\n", json_text({{"path", options.path}, {"gaussians", model->count()}}));
  } else {
    fmt::print("{}: {} Gaussians\n", options.path, model->count());
  }
  return 0;
}

}  // namespace

void add_export_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* verb = app.add_subcommand("export", "Write the live model as a PLY file that 3DGS tools read");
  verb->add_option("file", options->path, "file to write (.ply)")->required();
  verb->add_option("--timeout", options->timeout_s, "seconds to wait for the model (default 30)")
      ->check(CLI::PositiveNumber);
  verb->add_flag("--json", options->json, "print the result as JSON");
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return export_model(*options); }; });
}

}  // namespace splatbus::cli
