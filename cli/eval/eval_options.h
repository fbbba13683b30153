#pragma once

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "evaluation_setup.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "terminal.h"
#include "verbs.h"

namespace splatbus::cli {

/// What every evaluation has, as the command line gives it.
struct CommonOptions {
  std::string default_launch = "eval_fixed.yaml";  ///< under launch/
  std::string launch_file;
  std::string out = "out/eval";
  bool json = false;

  void complete(EvaluationSetup& setup) const {
    setup.launch_file = launch_file.empty() ? default_launch_file(default_launch) : std::filesystem::path(launch_file);
    setup.out = out;
  }
};

/// Runs an evaluation that tells only its state on the way; `evaluate` is given the signals and what shows a state.
template <class Evaluate>
int evaluate(const CommonOptions& options, const char* files, Evaluate evaluate) {
  const StopSignals signals;
  ProgressLine line;
  const nlohmann::json summary = evaluate(signals, [&](const std::string& state) {
    if (options.json) {
      fmt::print("{}\n", json_text({{"state", state}}));
      std::fflush(stdout);
    } else {
      line.show(state);
    }
  });
  line.finish();
  fmt::print("{}\n", json_text(summary, options.json ? -1 : 2));
  if (!options.json) fmt::print("{}: {}\n", options.out, files);
  return 0;
}

void add_setup_options(CLI::App& verb, CommonOptions& options, EvaluationSetup& setup);

/// `eval stream`, and `eval followers`, of which it starts some.
void add_stream_verbs(CLI::App& eval, Action& action);

}  // namespace splatbus::cli
