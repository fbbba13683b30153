#include "dynamics_evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>

#include "figures.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "schema_json.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr int kPointLights = 3;
constexpr const char* kHeader =
    "run,time_s,camera,picture,ssim,psnr,flip,masked_ssim,masked_psnr,masked_flip,shadow_ssim,shadow_psnr,shadow_flip,"
    "still_masked_ssim,still_shadow_ssim,ghost_flip,settled_flip\n";
constexpr const char* kStreamHeader = "run,time_s,packet,kbps,state_delay_ms_median,state_delay_ms_p99\n";

Json figure(const std::optional<double>& value) {
  return value ? Json(rounded(*value)) : Json();
}

template <class Get>
std::vector<TimedFigure> series_of(const DynamicsResults& results, bool paired_alone, Get get) {
  std::vector<TimedFigure> figures;
  for (const DynamicsSample& sample : results.samples) {
    if (sample.extra || (paired_alone && !sample.paired)) continue;
    if (const std::optional<double> value = get(sample)) figures.push_back({sample.time_s, *value});
  }
  return figures;
}

/// One figure of every sample that is judged and has it. Where this process did not come by a picture's own visibility
/// in time, what it drew is of two instants and says nothing.
template <class Get>
std::vector<TimedFigure> series(const DynamicsResults& results, Get get) {
  return series_of(results, true, get);
}

template <class Get>
Json mean(const DynamicsResults& results, Get get) {
  return figure(mean_within(series(results, get), results.window));
}

/// Getters of whole-picture figures for mean() and series().
auto of_drawn(std::optional<DrawnFigures> DynamicsSample::*drawn, double metrics::Quality::*member) {
  return [=](const DynamicsSample& sample) -> std::optional<double> {
    if (!(sample.*drawn)) return {};
    return (sample.*drawn)->whole.*member;
  };
}

using Part = std::optional<double> MaskedFigures::*;

auto of_part(std::optional<DrawnFigures> DynamicsSample::*drawn, Part part) {
  return [=](const DynamicsSample& sample) -> std::optional<double> {
    if (!(sample.*drawn)) return {};
    return (sample.*drawn)->masked.*part;
  };
}

/// Whether this process came by a picture's visibility in time says nothing of the viewer.
template <class Get>
std::vector<TimedFigure> viewer_series(const DynamicsResults& results, Get get) {
  return series_of(results, false, get);
}

template <class Get>
Json viewer_mean(const DynamicsResults& results, Get get) {
  return figure(mean_within(viewer_series(results, get), results.window));
}

/// By how much the same pixels are better in the still scene, of the pictures that have both.
auto drop_of(std::optional<DrawnFigures> DynamicsSample::*drawn, Part part) {
  return [=](const DynamicsSample& sample) -> std::optional<double> {
    if (!(sample.*drawn) || !((sample.*drawn)->masked.*part) || !(sample.still.*part)) return {};
    return *(sample.still.*part) - *((sample.*drawn)->masked.*part);
  };
}

std::string csv_rows(const char* run, const DynamicsResults& results) {
  std::string rows;
  const auto number = [](const std::optional<double>& value) {
    return value ? fmt::format("{:.5f}", *value) : std::string();
  };
  const auto decibels = [&](const std::optional<double>& psnr) {
    return psnr ? fmt::format("{:.3f}", finite_psnr(*psnr)) : std::string();
  };
  const auto add = [&](const DynamicsSample& sample, const char* picture, const DrawnFigures& figures) {
    rows += fmt::format(
        "{},{:.3f},{},{},{:.5f},{},{:.5f},{},{},{},{},{},{},{},{},{},{}\n", run, sample.time_s, sample.camera, picture,
        figures.whole.ssim, decibels(figures.whole.psnr_db), figures.whole.flip, number(figures.masked.moving),
        decibels(figures.masked_psnr.moving), number(figures.masked_flip.moving), number(figures.masked.shadow),
        decibels(figures.masked_psnr.shadow), number(figures.masked_flip.shadow), number(sample.still.moving),
        number(sample.still.shadow), number(figures.ghost_flip), number(figures.settled_flip));
  };
  for (const DynamicsSample& sample : results.samples) {
    if (sample.on) add(sample, "on", *sample.on);
    if (sample.off) add(sample, "off", *sample.off);
    if (sample.viewer) add(sample, "viewer", *sample.viewer);
  }
  return rows;
}

/// Rates of each packet type between two readings of the streamer's counters, a second or so apart.
std::string stream_rows(const char* run, const DynamicsResults& results) {
  std::string rows;
  const auto number = [](const std::optional<double>& value) {
    return value ? fmt::format("{:.2f}", *value) : std::string();
  };
  for (std::size_t k = 1; k < results.stream.size(); ++k) {
    const StreamSecond &before = results.stream[k - 1], &now = results.stream[k];
    const double seconds = static_cast<double>(now.published_ns - before.published_ns) / 1e9;
    for (const auto& [type, bytes] : now.total_bytes) {
      const auto known = before.total_bytes.find(type);
      const std::uint64_t bytes_before = known != before.total_bytes.end() ? known->second : 0;
      const auto kbps = kilobits_per_s(bytes_before, bytes, seconds);
      rows += fmt::format("{},{:.3f},{},{},{},{}\n", run, now.time_s, type, number(kbps),
                          number(now.state_delay_ms_median), number(now.state_delay_ms_p99));
    }
  }
  return rows;
}

/// Mean over the objects that were away and are there again, of all cameras.
std::optional<double> return_drop(const DynamicsResults& results) {
  std::vector<double> drops;
  for (std::size_t camera = 0; camera < kDynamicsCameras; ++camera) {
    std::vector<ObjectFigures> seen;
    for (const DynamicsSample& sample : results.samples) {
      if (sample.camera != camera || !sample.on) continue;
      seen.push_back({.existing = sample.objects, .of_object = {}});
      if (sample.paired && results.window.contains(sample.time_s)) seen.back().of_object = sample.on->object_ssim;
    }
    const std::vector<double> of_camera = return_drops(seen);
    drops.insert(drops.end(), of_camera.begin(), of_camera.end());
  }
  if (drops.empty()) return {};
  return std::accumulate(drops.begin(), drops.end(), 0.0) / static_cast<double>(drops.size());
}

std::optional<double> ghost_flip(const DynamicsSample& sample) {
  return sample.on && sample.still_ghost_flip ? sample.on->ghost_flip : std::nullopt;
}

std::optional<double> viewer_ghost_flip(const DynamicsSample& sample) {
  return sample.viewer && sample.still_ghost_flip ? sample.viewer->ghost_flip : std::nullopt;
}

std::optional<double> settled_flip(const DynamicsSample& sample) {
  return sample.on ? sample.on->settled_flip : std::nullopt;
}

std::optional<double> still_ghost_flip(const DynamicsSample& sample) {
  return sample.on && sample.on->ghost_flip ? sample.still_ghost_flip : std::nullopt;
}

/// Over the whole run: whether there is a drift.
Json by_minute(const std::vector<TimedFigure>& figures) {
  Json minutes = Json::array();
  double end_s = 0;
  for (const TimedFigure& figure : figures) end_s = std::max(end_s, figure.time_s);
  for (int minute = 0; 60.0 * minute < end_s; ++minute) {
    const double from_s = 60.0 * minute;
    minutes.push_back(cli::figure(mean_within(figures, {.from_s = from_s, .to_s = from_s + 60})));
  }
  return minutes;
}

const char* name_of(SceneLight light) {
  switch (light) {
    case SceneLight::FixedSun:
      return "fixed";
    case SceneLight::TurningSun:
      return "turning";
    case SceneLight::PointLights:
      return "points";
  }
  return "";
}

void write_sheet(const DynamicsResults& results, std::size_t camera, const fs::path& path) {
  metrics::ContactSheet sheet{.title = fmt::format("held-out camera {} through time", camera),
                              .columns = {},
                              .rows = {{.caption = "engine", .figures = {}, .pictures = {}},
                                       {.caption = "off", .figures = {"state frozen", "at the start"}, .pictures = {}},
                                       {.caption = "on", .figures = {}, .pictures = {}},
                                       {.caption = "viewer", .figures = {"its own picture"}, .pictures = {}}},
                              .picture_height = 192};
  for (const DynamicsPictures& pictures : results.pictures) {
    const DynamicsSample& sample = results.samples[pictures.sample];
    if (sample.camera != camera) continue;
    std::string title = fmt::format("{:.1f} s", sample.time_s);
    if (sample.off) title += fmt::format("  off {:.3f}", sample.off->whole.ssim);
    if (sample.on) title += fmt::format("  on {:.3f}", sample.on->whole.ssim);
    if (sample.viewer) title += fmt::format("  viewer {:.3f}", sample.viewer->whole.ssim);
    sheet.columns.push_back(title);
    sheet.rows[0].pictures.push_back(pictures.engine);
    sheet.rows[1].pictures.push_back(pictures.off);
    sheet.rows[2].pictures.push_back(pictures.on);
    sheet.rows[3].pictures.push_back(pictures.viewer);
  }
  if (!sheet.columns.empty()) metrics::write_png(path, metrics::draw(sheet));
}

/// An instant, and what has changed since the one before.
struct Motion {
  const DynamicsPictures* pictures = nullptr;
  cv::Mat residual;
};

/// Of neighbouring instants a tenth of a second or so apart.
std::vector<Motion> motion_of(const DynamicsResults& results) {
  constexpr double kNeighbours_s = 0.15;
  std::vector<Motion> motion;
  for (std::size_t k = 1; k < results.motion.size(); ++k) {
    const DynamicsPictures &before = results.motion[k - 1], &now = results.motion[k];
    const DynamicsSample &was = results.samples[before.sample], &is = results.samples[now.sample];
    if (!was.paired || !is.paired || is.time_s - was.time_s > kNeighbours_s) continue;
    motion.push_back({&now, motion_residual(before.engine, now.engine, before.on, now.on)});
  }
  return motion;
}

/// Mean over pixels and instants, of 255; nullopt without any.
std::optional<double> mean_residual(const DynamicsResults& results) {
  const std::vector<Motion> motion = motion_of(results);
  if (motion.empty()) return {};
  double sum = 0;
  for (const Motion& instant : motion) {
    const cv::Scalar mean = cv::mean(instant.residual);
    sum += (mean[0] + mean[1] + mean[2]) / 3;
  }
  return sum / static_cast<double>(motion.size());
}

void write_motion_sheet(const DynamicsResults& results, const fs::path& path) {
  constexpr std::size_t kMost = 12;
  const std::vector<Motion> motion = motion_of(results);
  if (motion.empty()) return;
  metrics::ContactSheet sheet{
      .title = "camera 0, instant by instant",
      .columns = {},
      .rows = {{.caption = "engine", .figures = {}, .pictures = {}},
               {.caption = "on", .figures = {}, .pictures = {}},
               {.caption = "residual", .figures = {"of the change", "8 times"}, .pictures = {}}},
      .picture_height = 192};
  for (std::size_t k = 0; k < std::min(motion.size(), kMost); ++k) {
    const DynamicsPictures& now = *motion[k].pictures;
    sheet.columns.push_back(fmt::format("{:.2f} s", results.samples[now.sample].time_s));
    sheet.rows[0].pictures.push_back(now.engine);
    sheet.rows[1].pictures.push_back(now.on);
    sheet.rows[2].pictures.push_back(motion[k].residual * 8);
  }
  metrics::write_png(path, metrics::draw(sheet));
}

}  // namespace

Json summarize_still(const DynamicsResults& still) {
  return {{"still_ssim", mean(still, of_drawn(&DynamicsSample::on, &metrics::Quality::ssim))},
          {"still_flip", mean(still, of_drawn(&DynamicsSample::on, &metrics::Quality::flip))},
          {"still_ssim_viewer", viewer_mean(still, of_drawn(&DynamicsSample::viewer, &metrics::Quality::ssim))},
          {"still_motion_residual", figure(mean_residual(still))}};
}

Json summarize_living(const DynamicsResults& living) {
  const auto on = &DynamicsSample::on;
  const auto off = &DynamicsSample::off;
  const auto viewer = &DynamicsSample::viewer;
  const auto ssim = &metrics::Quality::ssim;
  const auto flip = &metrics::Quality::flip;
  std::size_t paired = 0;
  for (const DynamicsSample& sample : living.samples) paired += sample.paired ? 1 : 0;
  return {
      {"on_ssim", mean(living, of_drawn(on, ssim))},
      {"on_flip", mean(living, of_drawn(on, flip))},
      {"on_ssim_worst_second", figure(worst_second(series(living, of_drawn(on, ssim)), living.window))},
      {"off_ssim", mean(living, of_drawn(off, ssim))},
      {"off_flip", mean(living, of_drawn(off, flip))},
      {"masked_ssim", mean(living, of_part(on, &MaskedFigures::moving))},
      {"masked_ssim_off", mean(living, of_part(off, &MaskedFigures::moving))},
      {"masked_ssim_drop", mean(living, drop_of(on, &MaskedFigures::moving))},
      {"shadow_ssim", mean(living, of_part(on, &MaskedFigures::shadow))},
      {"shadow_ssim_off", mean(living, of_part(off, &MaskedFigures::shadow))},
      {"shadow_ssim_drop", mean(living, drop_of(on, &MaskedFigures::shadow))},
      {"ssim_viewer", viewer_mean(living, of_drawn(viewer, ssim))},
      {"ssim_viewer_worst_second", figure(worst_second(viewer_series(living, of_drawn(viewer, ssim)), living.window))},
      {"flip_viewer", viewer_mean(living, of_drawn(viewer, flip))},
      {"masked_ssim_viewer", viewer_mean(living, of_part(viewer, &MaskedFigures::moving))},
      {"masked_ssim_drop_viewer", viewer_mean(living, drop_of(viewer, &MaskedFigures::moving))},
      {"shadow_ssim_viewer", viewer_mean(living, of_part(viewer, &MaskedFigures::shadow))},
      {"shadow_ssim_drop_viewer", viewer_mean(living, drop_of(viewer, &MaskedFigures::shadow))},
      {"ghost_flip_viewer", viewer_mean(living, viewer_ghost_flip)},
      {"state_delay_ms_median", figure(living.state_delay_ms_median)},
      {"state_delay_ms_p99", figure(living.state_delay_ms_p99)},
      {"picture_age_ms_median", figure(living.picture_age_ms_median)},
      {"picture_age_ms_p99", figure(living.picture_age_ms_p99)},
      {"object_change_ms_max", figure(living.object_change_ms_max)},
      {"visibility_lead_ms_median", figure(living.visibility_lead_ms_median)},
      {"return_ssim_drop", figure(return_drop(living))},
      {"scene_kbps", figure(living.scene_kbps)},
      {"visibility_kbps", figure(living.visibility_kbps)},
      {"wire_mbps_mean", rounded(living.wire_mbps_mean)},
      {"gaussians", living.gaussians},
      {"steps_per_s", rounded(living.steps_per_s)},
      {"engine_frames_per_s", rounded(living.engine_frames_per_s)},
      {"unpaired_views", living.unpaired_views},
      {"pictures", living.samples.size()},
      {"pictures_paired", paired},
      {"ghost_flip", mean(living, ghost_flip)},
      {"ghost_flip_still", mean(living, still_ghost_flip)},
      {"ghost_flip_settled", mean(living, settled_flip)},
      {"motion_residual", figure(mean_residual(living))},
      {"on_ssim_by_minute", by_minute(series(living, of_drawn(on, ssim)))},
  };
}

Json run_dynamics_evaluation(const DynamicsOptions& options, const StopSignals& signals,
                             const std::function<void(const std::string&)>& show_state) {
  const fs::path& out = options.setup.out;
  fs::create_directories(out);
  const auto run = [&](const std::string& name, const EngineScene& scene, double seconds, Support support,
                       const MapsOfCameras* still) {
    const DynamicsRunOptions run_options{.setup = options.setup,
                                         .scene = scene,
                                         .seconds = seconds,
                                         .support = support,
                                         .log = out / fmt::format("services_{}.log", name),
                                         .viewer_pictures = out / fmt::format("viewer_{}", name)};
    DynamicsResults results =
        run_dynamics(run_options, signals, still, [&](const std::string& state) { show_state(name + ": " + state); });
    for (std::size_t camera = 0; camera < kDynamicsCameras; ++camera) {
      write_sheet(results, camera, out / fmt::format("{}_{}.png", name, camera));
    }
    write_motion_sheet(results, out / fmt::format("{}_motion.png", name));
    return results;
  };
  const EngineScene still_scene{.fps = options.fps, .reference_rate_hz = options.reference_rate_hz};
  Json summary = {{"seconds", options.seconds}};
  std::string csv = kHeader, stream_csv = kStreamHeader;
  std::optional<MapsOfCameras> still_maps;
  if (options.still_only || options.still_seconds > 0) {
    const DynamicsResults still =
        run("still", still_scene, options.still_only ? options.seconds : options.still_seconds, Support::On, nullptr);
    csv += csv_rows("still", still);
    stream_csv += stream_rows("still", still);
    summary.update(summarize_still(still));
    still_maps = still.mean_maps;
  }
  for (const SceneLight light : options.still_only ? std::vector<SceneLight>() : options.lights) {
    EngineScene scene = still_scene;
    scene.moving_objects = true;
    if (light == SceneLight::TurningSun) scene.sun_rate_deg_s = options.sun_rate_deg_s;
    if (light == SceneLight::PointLights) scene.point_lights = kPointLights;
    // What stood under the sun says nothing of pixels at night.
    const bool comparable = still_maps && light != SceneLight::PointLights;
    const DynamicsResults living =
        run(name_of(light), scene, options.seconds, options.support, comparable ? &*still_maps : nullptr);
    csv += csv_rows(name_of(light), living);
    stream_csv += stream_rows(name_of(light), living);
    const Json figures = summarize_living(living);
    if (light == options.lights.front()) summary.update(figures);
    summary[name_of(light)] = figures;
  }
  write_text(out / "figures.csv", csv);
  write_text(out / "stream.csv", stream_csv);
  write_text(out / "summary.json", json_text(summary, 2) + "\n");
  return summary;
}

}  // namespace splatbus::cli
