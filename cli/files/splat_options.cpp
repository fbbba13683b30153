#include "splat_options.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <map>

#include "schema_json.h"

namespace splatbus::cli {

void add_axes_option(CLI::App& verb, splats::Axes& axes, const std::string& name) {
  static const std::map<std::string, splats::Axes> kNames = {
      {"auto", splats::Axes::OfFormat}, {"keep", splats::Axes::Keep}, {"turn", splats::Axes::Turn}};
  verb.add_option(name, axes,
                  "axes of the file: auto (y down in .ply, y up in .glb and .spz), keep (y up, as in the world), turn "
                  "(half a turn about z)")
      ->transform(CLI::Transformer(kNames).description("auto, keep or turn"))
      ->default_str("auto");
}

void add_write_options(CLI::App& verb, splats::WriteOptions& options) {
  add_axes_option(verb, options.axes);
  verb.add_option("--spz-version", options.spz_version, "version of .spz files: 4 (default), or 3 for older readers")
      ->check(CLI::IsMember({3, 4}));
}

void print_written(const std::string& path, std::size_t gaussians, bool json) {
  if (json) {
    fmt::print("{}\n", json_text({{"path", path}, {"gaussians", gaussians}}));
  } else {
    fmt::print("{}: {} Gaussians\n", path, gaussians);
  }
}

}  // namespace splatbus::cli
