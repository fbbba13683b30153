// The inspecting verbs as a program of their own, for the tests that need them under a terminal.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <exception>

#include "verbs.h"

int main(int argc, char** argv) {
  CLI::App app;
  splatbus::cli::Action action;
  splatbus::cli::add_top_verb(app, action);
  splatbus::cli::add_trace_verb(app, action);
  CLI11_PARSE(app, argc, argv);
  try {
    return action();
  } catch (const std::exception& error) {
    fmt::print(stderr, "{}\n", error.what());
    return 1;
  }
}
