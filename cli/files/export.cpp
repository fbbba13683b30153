#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <stdexcept>

#include "live_scene.h"
#include "splat_options.h"
#include "splats/file.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

struct ExportOptions {
  std::string bus;
  std::string path;
  std::string from;
  splats::Axes from_axes = splats::Axes::OfFormat;
  double timeout_s = 30;
  bool json = false;
  splats::WriteOptions write;
};

int convert(const ExportOptions& options) {
  const splats::SplatFile file = splats::read_file(options.from, options.from_axes);
  splats::WriteOptions write = options.write;
  write.mip = file.mip;
  print_written(options.path, splats::write_file(options.path, file.gaussians.view(), {}, write), options.json);
  return 0;
}

int export_model(const ExportOptions& options) {
  (void)splats::format_of(options.path);
  if (!options.from.empty()) return convert(options);
  const bus::Address address = bus_address(options.bus);
  LiveScene live(connect(address));
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.timeout_s * 1e9);
  while (bus::now_ns() < end_ns && (!live.published() || !live.has_scene())) {
    live.poll(std::chrono::milliseconds(50));
  }
  const auto model = live.copy_average(std::chrono::milliseconds(1000));
  if (!model) {
    throw std::runtime_error(
        fmt::format("no model on {1} within {0} s: is a trainer running?", options.timeout_s, address.text()));
  }
  if (model->layout().appearance == Appearance::Transfer && !live.has_scene()) {
    throw std::runtime_error(
        fmt::format("no scene state on {1} within {0} s, which this model is shaded with: is a capture-bridge running?",
                    options.timeout_s, address.text()));
  }
  print_written(options.path, splats::write_file(options.path, model->view(), live.scene(), options.write),
                options.json);
  return 0;
}

}  // namespace

void add_export_verb(CLI::App& app, Action& action) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* verb =
      app.add_subcommand("export", "Write the live model under its current light to a file for splat tools");
  verb->add_option("file", options->path, "file to write (.ply, .glb, .spz)")->required();
  add_write_options(*verb, options->write);
  verb->add_option("--from", options->from, "convert a file (.ply, .spz) instead of the live model");
  add_axes_option(*verb, options->from_axes, "--from-axes");
  verb->add_option("--timeout", options->timeout_s, "seconds to wait for the model (default 30)")
      ->check(CLI::PositiveNumber);
  verb->add_flag("--json", options->json, "print the result as JSON");
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return export_model(*options); }; });
}

}  // namespace splatbus::cli
