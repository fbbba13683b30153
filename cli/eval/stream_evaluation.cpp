#include "stream_evaluation.h"

#include <fmt/format.h>

#include <utility>

#include "figures.h"
#include "schema_json.h"
#include "stream_sheets.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

void write_all(const std::vector<NamedStream>& runs, const std::filesystem::path& out) {
  write_text(out / "figures.csv", stream_csv(runs));
  write_text(out / "bitrate.csv", bitrate_csv(runs));
  write_text(out / "server.csv", server_csv(runs));
  write_stream_plots(runs, out / "figures.png");
}

}  // namespace

Json run_stream_evaluation(const StreamOptions& options, const StopSignals& signals,
                           const std::function<void(const std::string&)>& show_state) {
  const std::filesystem::path& out = options.run.setup.out;
  std::filesystem::create_directories(out);
  std::vector<NamedStream> runs;
  const auto run = [&](const StreamRunOptions& run_options, const std::string& name) {
    runs.push_back({.name = name, .results = run_stream(run_options, name, signals, [&](const std::string& state) {
                                    show_state(name + ": " + state);
                                  })});
    return summarize_stream(runs.back().results);
  };
  Json summary;
  if (options.curve_mbps.empty()) {
    summary = run(options.run, options.run.walk ? "walk" : "stream");
  } else {
    Json curve = Json::array();
    for (const double mbps : options.curve_mbps) {
      StreamRunOptions at_rate = options.run;
      at_rate.shape.mbps = mbps;
      curve.push_back(run(at_rate, fmt::format("{:g} Mbit/s", mbps)));
    }
    summary = curve.back();
    summary["curve"] = std::move(curve);
  }
  write_all(runs, out);
  summary.update({{"seconds", options.run.seconds}, {"seed", options.run.setup.seed}, {"walk", options.run.walk}});
  write_text(out / "summary.json", json_text(summary, 2) + "\n");
  return summary;
}

}  // namespace splatbus::cli
