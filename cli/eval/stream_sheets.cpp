#include "stream_sheets.h"

#include <fmt/format.h>

#include <numeric>
#include <utility>

#include "metrics/image_io.h"
#include "metrics/plot.h"

namespace splatbus::cli {

namespace {

constexpr double kShown = 0.01;  // of all bits, in a plot

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

TimeWindow whole_run(const StreamResults& results) {
  return {.from_s = 0, .to_s = results.end_s};
}

metrics::Plot bits_plot(const NamedStream& run) {
  metrics::Plot plot{.title = fmt::format("{}: Mbit/s by packet type", run.name), .x_label = "seconds", .lines = {}};
  const StreamResults& results = run.results;
  const BitsBySecond bits = megabits_by_second(results.arrivals, results.begin_ns, whole_run(results));
  const auto add = [&](std::string name, std::vector<double> seconds) {
    metrics::PlotLine line{.name = std::move(name), .x = {}, .y = std::move(seconds)};
    for (std::size_t i = 0; i < line.y.size(); ++i) line.x.push_back(static_cast<double>(i));
    plot.lines.push_back(std::move(line));
  };
  const std::vector<double> total = total_of(bits);
  add("all", total);
  for (const auto& [body, seconds] : bits) {
    if (sum(seconds) > kShown * sum(total)) add(wire::EnumNameBody(body), seconds);
  }
  if (results.whole_s) plot.marks.push_back({*results.whole_s, "whole"});
  if (results.cut) {
    plot.marks.push_back({results.cut->from_s, "cut"});
    plot.marks.push_back({results.cut->to_s, "again"});
  }
  return plot;
}

metrics::Plot ssim_plot(const NamedStream& run) {
  metrics::PlotLine server{.name = "server", .x = {}, .y = {}}, viewer{.name = "viewer", .x = {}, .y = {}};
  for (const StreamSample& sample : run.results.samples) {
    server.x.push_back(sample.time_s);
    viewer.x.push_back(sample.time_s);
    server.y.push_back(sample.ssim_server);
    viewer.y.push_back(sample.ssim_viewer);
  }
  return {.title = run.name + ": SSIM",
          .x_label = "seconds",
          .lines = {std::move(server), std::move(viewer)},
          .y_from = 0.5};
}

/// SSIM over the link's rate; without lines where fewer than two runs have one.
metrics::Plot curve_plot(std::span<const NamedStream> runs) {
  metrics::PlotLine server{.name = "server", .x = {}, .y = {}}, viewer{.name = "viewer", .x = {}, .y = {}};
  for (const NamedStream& run : runs) {
    const nlohmann::json summary = summarize_stream(run.results);
    if (run.results.mbps <= 0 || !summary["ssim_viewer"].is_number()) continue;
    server.x.push_back(run.results.mbps);
    viewer.x.push_back(run.results.mbps);
    server.y.push_back(summary["ssim_server"].get<double>());
    viewer.y.push_back(summary["ssim_viewer"].get<double>());
  }
  metrics::Plot plot{.title = "SSIM over the link's rate", .x_label = "Mbit/s", .lines = {}, .y_from = 0.5};
  if (server.x.size() > 1) plot.lines = {std::move(server), std::move(viewer)};
  return plot;
}

}  // namespace

std::string stream_csv(std::span<const NamedStream> runs) {
  std::string text = "run,time_s,ssim_server,ssim_viewer\n";
  for (const auto& [name, results] : runs) {
    for (const StreamSample& sample : results.samples) {
      text += fmt::format("{},{:.3f},{:.5f},{:.5f}\n", name, sample.time_s, sample.ssim_server, sample.ssim_viewer);
    }
  }
  return text;
}

std::string bitrate_csv(std::span<const NamedStream> runs) {
  std::string text = "run,second,type,megabits\n";
  for (const auto& [name, results] : runs) {
    for (const auto& [body, seconds] : megabits_by_second(results.arrivals, results.begin_ns, whole_run(results))) {
      for (std::size_t i = 0; i < seconds.size(); ++i) {
        text += fmt::format("{},{},{},{:.6g}\n", name, i, wire::EnumNameBody(body), seconds[i]);
      }
    }
  }
  return text;
}

std::string server_csv(std::span<const NamedStream> runs) {
  std::string text = "run,time_s,viewers,tick_ms,cpu_share,resident_mb\n";
  for (const auto& [name, results] : runs) {
    for (const ServerSample& sample : results.server) {
      text += fmt::format("{},{:.3f},{},{:.3f},{:.4f},{:.3f}\n", name, sample.time_s, sample.viewers, sample.tick_ms,
                          sample.cpu_share, sample.resident_mb);
    }
  }
  return text;
}

void write_stream_plots(std::span<const NamedStream> runs, const std::filesystem::path& path) {
  std::vector<metrics::Plot> plots;
  if (metrics::Plot curve = curve_plot(runs); !curve.lines.empty()) plots.push_back(std::move(curve));
  for (const NamedStream& run : runs) {
    plots.push_back(bits_plot(run));
    plots.push_back(ssim_plot(run));
  }
  metrics::write_png(path, metrics::draw(plots));
}

}  // namespace splatbus::cli
