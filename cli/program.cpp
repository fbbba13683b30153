#include "program.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <exception>

#include "bus/command_line.h"

namespace splatbus::cli {

int run_program(int argc, char** argv, std::span<const AddVerb> verbs) try {
  CLI::App app{"splatbus turns a live game engine into a stream of 3D Gaussians."};
  app.name("splatbus");
  app.set_version_flag("--version", "splatbus " SPLATBUS_VERSION);
  app.require_subcommand(1);
  Action action;
  for (const AddVerb add : verbs) add(app, action);
  if (const auto status = bus::parse_command_line(app, argc, argv)) return *status;
  return action();
} catch (const std::exception& error) {
  fmt::print(stderr, "splatbus: {}\n", error.what());
  return 1;
}

}  // namespace splatbus::cli
