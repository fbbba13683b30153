#include "explore_evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "dynamics_figures.h"
#include "explore_sheets.h"
#include "figures.h"
#include "schema_json.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

constexpr double kEarly_s = 30, kWindow_s = 10;
constexpr double kFirst_s = 5;  // of the walk, whose holes do not count
constexpr double kMegabyte = 1e6;

std::uint64_t total_gaussians(const ExploreSample& sample) {
  return sample.trainer.gaussians + sample.trainer.spilled;
}

Json or_null(const std::optional<double>& value) {
  return value ? Json(rounded(*value)) : Json();
}

/// The samples before the teleport.
std::vector<const ExploreSample*> walked(const ExploreResults& results) {
  std::vector<const ExploreSample*> samples;
  for (const ExploreSample& sample : results.samples) {
    if (sample.phase != ExplorePhase::Teleported) samples.push_back(&sample);
  }
  return samples;
}

/// By how much one counter has grown for each unit of another within a window; nullopt where that has not.
template <class Above, class Below>
std::optional<double> ratio_within(const std::vector<const ExploreSample*>& samples, const TimeWindow& window,
                                   Above above, Below below) {
  const ExploreSample *first = nullptr, *last = nullptr;
  for (const ExploreSample* sample : samples) {
    if (!window.contains(sample->time_s)) continue;
    if (first == nullptr) first = sample;
    last = sample;
  }
  if (first == nullptr) return {};
  const double grown = static_cast<double>(below(*last)) - static_cast<double>(below(*first));
  if (grown <= 0) return {};
  return (static_cast<double>(above(*last)) - static_cast<double>(above(*first))) / grown;
}

template <class Get>
std::optional<double> mean_of(const std::vector<const ExploreSample*>& samples, const TimeWindow& window, Get get) {
  std::vector<TimedFigure> figures;
  for (const ExploreSample* sample : samples) {
    if (const std::optional<double> value = get(*sample)) figures.push_back({sample->time_s, *value});
  }
  return mean_within(figures, window);
}

/// Of the first viewer.
template <class Member>
auto figure_of(Member member, std::size_t viewer = 0) {
  return [=](const ExploreSample& sample) -> std::optional<double> {
    if (viewer >= sample.viewers.size() || !sample.viewers[viewer]) return {};
    return (*sample.viewers[viewer]).*member;
  };
}

struct Windows {
  TimeWindow early, end, all;
};

Windows windows_of(const ExploreResults& results) {
  const double early_s = std::min(kEarly_s, results.walk_s / 3);
  const double window_s = std::min(kWindow_s, results.walk_s / 6);
  return {.early = {.from_s = early_s - window_s / 2, .to_s = early_s + window_s / 2},
          .end = {.from_s = results.walk_s - window_s, .to_s = results.walk_s},
          .all = {.from_s = 0, .to_s = results.walk_s}};
}

}  // namespace

std::optional<double> step_ms(const ExploreResults& results, const TimeWindow& window) {
  const auto seconds_a_step = ratio_within(
      walked(results), window, [](const ExploreSample& sample) { return sample.trainer.optimizer_s; },
      [](const ExploreSample& sample) { return sample.trainer.step; });
  if (!seconds_a_step) return {};
  return *seconds_a_step * 1e3;
}

Json summarize_exploration(const ExploreResults& results) {
  const Windows windows = windows_of(results);
  const std::vector<const ExploreSample*> samples = walked(results);
  const auto views_per_s = ratio_within(
      samples, windows.end, [](const ExploreSample& sample) { return sample.trainer.views; },
      [](const ExploreSample& sample) { return sample.trainer.optimizer_s; });
  double device_mb = 0, host_mb = 0, model_host_mb = 0, disk_mb = 0;
  for (const ExploreSample& sample : results.samples) {
    device_mb = std::max(device_mb, static_cast<double>(sample.trainer.device_bytes) / kMegabyte);
    host_mb = std::max(host_mb, static_cast<double>(sample.resident_bytes) / kMegabyte);
    model_host_mb = std::max(model_host_mb, static_cast<double>(sample.trainer.host_bytes) / kMegabyte);
    disk_mb = std::max(disk_mb, static_cast<double>(sample.trainer.disk_bytes) / kMegabyte);
  }
  std::optional<double> unmodelled_max;
  const ExploreSample *before_return = nullptr, *after_return = nullptr;
  for (const ExploreSample* sample : samples) {
    (sample->phase == ExplorePhase::Out ? before_return : after_return) = sample;
    const auto share = figure_of(&ViewerFigures::unmodelled_share)(*sample);
    if (share && sample->time_s >= kFirst_s) unmodelled_max = std::max(unmodelled_max.value_or(0), *share);
  }
  const auto gaussians = [](const ExploreSample* sample) {
    return sample == nullptr ? Json() : Json(total_gaussians(*sample));
  };
  // Of the way back: what is on ground that nobody has seen before, a thing's far side say, is no growth of the rest.
  Json inserted_back;
  if (before_return != nullptr && after_return != nullptr) {
    const Inserted &before = before_return->inserted, &after = after_return->inserted;
    inserted_back = {
        {"bare", after.bare - before.bare}, {"hole", after.hole - before.hole}, {"fill", after.fill - before.fill}};
  }
  const std::optional<Stations::Means> stations = results.stations.means();
  const ExploreSample* last = results.samples.empty() ? nullptr : &results.samples.back();
  Json summary{{"gaussians_total", gaussians(last)},
               {"gaussians_active", last == nullptr ? Json() : Json(last->trainer.active)},
               {"step_ms_at_30s", or_null(step_ms(results, windows.early))},
               {"step_ms_at_end", or_null(step_ms(results, windows.end))},
               {"active_mb_at_30s", or_null(mean_of(samples, windows.early, active_mb))},
               {"active_mb_at_end", or_null(mean_of(samples, windows.end, active_mb))},
               {"device_mb_peak", rounded(device_mb)},
               {"host_mb_peak", rounded(host_mb)},
               {"model_host_mb_peak", rounded(model_host_mb)},
               {"disk_mb", rounded(disk_mb)},
               {"unmodelled_share_max", or_null(unmodelled_max)},
               {"ssim_mean", or_null(mean_of(samples, windows.all, figure_of(&ViewerFigures::ssim)))},
               {"flip_mean", or_null(mean_of(samples, windows.all, figure_of(&ViewerFigures::flip)))},
               {"ssim_left", stations ? Json(rounded(stations->left)) : Json()},
               {"ssim_return", stations ? Json(rounded(stations->back)) : Json()},
               {"stations", stations ? stations->stations : 0},
               {"gaussians_before_return", gaussians(before_return)},
               {"gaussians_after_return", gaussians(after_return)},
               {"inserted_back", inserted_back},
               {"views_per_s_at_end", or_null(views_per_s)},
               {"views_per_s_ratio", nullptr},
               {"teleport_whole_s", or_null(results.teleport_whole_s)},
               {"walk_s", rounded(results.walk_s)},
               {"out_s", rounded(results.out_s)},
               {"pictures", std::ranges::count_if(results.samples,
                                                  [](const ExploreSample& sample) {
                                                    return std::ranges::any_of(sample.viewers, [](const auto& figures) {
                                                      return figures.has_value();
                                                    });
                                                  })},
               {"unanswered_by_engine", results.unanswered_by_engine},
               {"unanswered_by_viewer", results.unanswered_by_viewer}};
  if (last != nullptr && last->viewers.size() > 1) {
    summary["ssim_mean_second"] = or_null(mean_of(samples, windows.all, figure_of(&ViewerFigures::ssim, 1)));
  }
  return summary;
}

namespace {

/// Runs once, writes what came of it under names that end with `suffix`, and summarises it.
class ExploreRuns {
 public:
  ExploreRuns(const ExploreOptions& options, const StopSignals& signals,
              const std::function<void(const std::string&)>& show_state)
      : signals_(signals),
        show_state_(show_state),
        out_(options.run.setup.out),
        single_(!options.compare && !options.halve && !options.alone) {}

  Json run(const ExploreRunOptions& options, const std::string& name, const std::string& suffix) {
    const ExploreResults results = run_exploration(
        options, name, signals_, [&](const std::string& state) { show_state_(single_ ? state : name + ": " + state); });
    apart_m_ = results.apart_m;
    write_text(out_ / ("figures" + suffix + ".csv"), exploration_csv(results));
    write_exploration_plots(results, out_ / ("figures" + suffix + ".png"));
    write_exploration_sheet(results, results.pictures, "from where the viewer is",
                            out_ / ("contact_sheet" + suffix + ".png"));
    write_exploration_sheet(results, results.worst, "from where the viewer is, the worst of each part",
                            out_ / ("worst" + suffix + ".png"));
    return summarize_exploration(results);
  }
  [[nodiscard]] double apart_m() const { return apart_m_; }

 private:
  const StopSignals& signals_;
  const std::function<void(const std::string&)>& show_state_;
  std::filesystem::path out_;
  bool single_;
  double apart_m_ = 0;
};

/// The same run over a world of its own.
ExploreRunOptions beside(ExploreRunOptions options, const char* name) {
  if (!options.world.empty()) options.world += std::string("_") + name;
  return options;
}

/// Half of it in MiB, for a ceiling; null: none.
std::uint64_t half_mb(const Json& megabytes) {
  const double half = megabytes.get<double>() * kMegabyte / 2 / (1U << 20U);
  return std::max<std::uint64_t>(1, static_cast<std::uint64_t>(half));
}

}  // namespace

Json run_explore_evaluation(const ExploreOptions& options, const StopSignals& signals,
                            const std::function<void(const std::string&)>& show_state) {
  const std::filesystem::path& out = options.run.setup.out;
  std::filesystem::create_directories(out);
  ExploreRunOptions first = options.run;
  if (options.halve && first.world.empty()) first.world = out / "world";
  ExploreRuns runs(options, signals, show_state);
  Json summary = runs.run(first, "explore", "");
  const double apart_m = runs.apart_m();
  if (options.compare) {
    ExploreRunOptions restless = beside(first, "restless");
    restless.rests = false;
    Json result = runs.run(restless, "restless", "_restless");
    const Json &rate = summary["views_per_s_at_end"], &rate_beside = result["views_per_s_at_end"];
    if (rate.is_number() && rate_beside.is_number() && rate_beside > 0) {
      summary["views_per_s_ratio"] = rounded(rate.get<double>() / rate_beside.get<double>());
    }
    result.erase("views_per_s_ratio");
    summary["restless"] = std::move(result);
  }
  if (options.halve) {
    ExploreRunOptions halved = beside(first, "halved");
    halved.memory_mb = half_mb(summary["device_mb_peak"]);
    halved.disk_mb = half_mb(summary["disk_mb"]);
    Json result = runs.run(halved, "halved", "_halved");
    result.update({{"memory_mb", halved.memory_mb}, {"disk_limit_mb", halved.disk_mb}});
    summary["halved"] = std::move(result);
  }
  for (int viewer = 0; options.alone && viewer < first.viewers; ++viewer) {
    const std::string name = "alone_" + std::to_string(viewer + 1);
    ExploreRunOptions alone = beside(first, name.c_str());
    alone.viewers = 1;
    alone.start_m += viewer * apart_m;
    summary[name] = runs.run(alone, name, "_" + name);
  }
  summary.update({{"seconds", options.run.seconds},
                  {"seed", options.run.setup.seed},
                  {"viewers", options.run.viewers},
                  {"scene", options.run.scene}});
  write_text(out / "summary.json", json_text(summary, 2) + "\n");
  return summary;
}

}  // namespace splatbus::cli
