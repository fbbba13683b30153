#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <exception>

#include "bus/command_line.h"
#include "verbs.h"

namespace {

using namespace splatbus;

int run(int argc, char** argv) {
  CLI::App app{"splatbus turns a live game engine into a stream of 3D Gaussians."};
  app.name("splatbus");
  app.set_version_flag("--version", "splatbus " SPLATBUS_VERSION);
  app.require_subcommand(1);
  splatbus::cli::Action action;
  splatbus::cli::add_launch_verb(app, action);
  splatbus::cli::add_operate_verbs(app, action);
  splatbus::cli::add_param_verb(app, action);
  splatbus::cli::add_topic_verb(app, action);
  splatbus::cli::add_node_verb(app, action);
  splatbus::cli::add_top_verb(app, action);
  splatbus::cli::add_trace_verb(app, action);
  splatbus::cli::add_doctor_verb(app, action);
  splatbus::cli::add_keys_verb(app, action);
  splatbus::cli::add_export_verb(app, action);
  splatbus::cli::add_health_verb(app, action);
  splatbus::cli::add_world_verb(app, action);
  splatbus::cli::add_eval_verb(app, action);
  splatbus::cli::add_demo_verb(app, action);
  splatbus::cli::add_view_verb(app, action);
  splatbus::cli::add_record_verb(app, action);
  splatbus::cli::add_play_verb(app, action);
  splatbus::cli::add_reference_verbs(app, action);
  if (const auto status = bus::parse_command_line(app, argc, argv)) return *status;
  return action();
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "splatbus: {}\n", error.what());
    return 1;
  }
}
