#include "dynamics_evaluation.h"

#include <fmt/format.h>

#include "figures.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "schema_json.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr const char* kHeader =
    "run,time_s,camera,picture,ssim,psnr,flip,masked_ssim,shadow_ssim,still_masked_ssim,still_shadow_ssim\n";

Json figure(const std::optional<double>& value) {
  return value ? Json(rounded(*value)) : Json();
}

/// One figure of every sample that has it.
template <class Get>
std::vector<TimedFigure> series(const DynamicsResults& results, Get get) {
  std::vector<TimedFigure> figures;
  for (const DynamicsSample& sample : results.samples) {
    if (const std::optional<double> value = get(sample)) figures.push_back({sample.time_s, *value});
  }
  return figures;
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

std::optional<double> viewer_ssim(const DynamicsSample& sample) {
  if (!sample.viewer) return {};
  return sample.viewer->ssim;
}

/// By how much the same pixels are better in the still scene, of the pictures that have both.
auto drop_of(Part part) {
  return [=](const DynamicsSample& sample) -> std::optional<double> {
    if (!sample.on || !(sample.on->masked.*part) || !(sample.still.*part)) return {};
    return *(sample.still.*part) - *(sample.on->masked.*part);
  };
}

std::string csv_rows(const char* run, const DynamicsResults& results) {
  std::string rows;
  const auto number = [](const std::optional<double>& value) {
    return value ? fmt::format("{:.5f}", *value) : std::string();
  };
  const auto add = [&](const DynamicsSample& sample, const char* picture, const metrics::Quality& quality,
                       const MaskedFigures& masked) {
    rows += fmt::format("{},{:.3f},{},{},{:.5f},{:.3f},{:.5f},{},{},{},{}\n", run, sample.time_s, sample.camera,
                        picture, quality.ssim, finite_psnr(quality.psnr_db), quality.flip, number(masked.moving),
                        number(masked.shadow), number(sample.still.moving), number(sample.still.shadow));
  };
  for (const DynamicsSample& sample : results.samples) {
    if (sample.on) add(sample, "on", sample.on->whole, sample.on->masked);
    if (sample.off) add(sample, "off", sample.off->whole, sample.off->masked);
    if (sample.viewer) add(sample, "viewer", *sample.viewer, {});
  }
  return rows;
}

void write_sheet(const DynamicsResults& results, std::size_t camera, const fs::path& path) {
  metrics::ContactSheet sheet{.title = fmt::format("held-out camera {} through time", camera),
                              .columns = {},
                              .rows = {{.caption = "engine", .figures = {}, .pictures = {}},
                                       {.caption = "off", .figures = {"state frozen", "at the start"}, .pictures = {}},
                                       {.caption = "on", .figures = {}, .pictures = {}}},
                              .picture_height = 192};
  for (const DynamicsPictures& pictures : results.pictures) {
    const DynamicsSample& sample = results.samples[pictures.sample];
    if (sample.camera != camera) continue;
    std::string title = fmt::format("{:.1f} s", sample.time_s);
    if (sample.off) title += fmt::format("  off {:.3f}", sample.off->whole.ssim);
    if (sample.on) title += fmt::format("  on {:.3f}", sample.on->whole.ssim);
    sheet.columns.push_back(title);
    sheet.rows[0].pictures.push_back(pictures.engine);
    sheet.rows[1].pictures.push_back(pictures.off);
    sheet.rows[2].pictures.push_back(pictures.on);
  }
  if (!sheet.columns.empty()) metrics::write_png(path, metrics::draw(sheet));
}

}  // namespace

Json summarize_dynamics(const DynamicsResults* still, const DynamicsResults* living) {
  const auto on = &DynamicsSample::on;
  const auto off = &DynamicsSample::off;
  const auto ssim = &metrics::Quality::ssim;
  const auto flip = &metrics::Quality::flip;
  Json summary = Json::object();
  if (still != nullptr) {
    summary["still_ssim"] = mean(*still, of_drawn(on, ssim));
    summary["still_flip"] = mean(*still, of_drawn(on, flip));
    summary["still_ssim_viewer"] = mean(*still, viewer_ssim);
  }
  if (living == nullptr) return summary;
  std::size_t paired = 0;
  for (const DynamicsSample& sample : living->samples) paired += sample.paired ? 1 : 0;
  summary.update({
      {"on_ssim", mean(*living, of_drawn(on, ssim))},
      {"on_flip", mean(*living, of_drawn(on, flip))},
      {"on_ssim_worst_second", figure(worst_second(series(*living, of_drawn(on, ssim)), living->window))},
      {"off_ssim", mean(*living, of_drawn(off, ssim))},
      {"off_flip", mean(*living, of_drawn(off, flip))},
      {"masked_ssim", mean(*living, of_part(on, &MaskedFigures::moving))},
      {"masked_ssim_off", mean(*living, of_part(off, &MaskedFigures::moving))},
      {"masked_ssim_drop", mean(*living, drop_of(&MaskedFigures::moving))},
      {"shadow_ssim", mean(*living, of_part(on, &MaskedFigures::shadow))},
      {"shadow_ssim_off", mean(*living, of_part(off, &MaskedFigures::shadow))},
      {"shadow_ssim_drop", mean(*living, drop_of(&MaskedFigures::shadow))},
      {"ssim_viewer", mean(*living, viewer_ssim)},
      {"ssim_viewer_worst_second", figure(worst_second(series(*living, viewer_ssim), living->window))},
      {"state_delay_ms_median", figure(living->state_delay_ms_median)},
      {"state_delay_ms_p99", figure(living->state_delay_ms_p99)},
      {"scene_kbps", figure(living->scene_kbps)},
      {"visibility_kbps", figure(living->visibility_kbps)},
      {"wire_mbps_mean", rounded(living->wire_mbps_mean)},
      {"gaussians", living->gaussians},
      {"steps_per_s", rounded(living->steps_per_s)},
      {"engine_frames_per_s", rounded(living->engine_frames_per_s)},
      {"unpaired_views", living->unpaired_views},
      {"pictures", living->samples.size()},
      {"pictures_paired", paired},
  });
  return summary;
}

Json run_dynamics_evaluation(const DynamicsOptions& options, const StopSignals& signals,
                             const std::function<void(const std::string&)>& show_state) {
  const fs::path& out = options.setup.out;
  fs::create_directories(out);
  const auto run = [&](bool living, const std::map<std::size_t, cv::Mat>* still) {
    DynamicsRunOptions run_options{.setup = options.setup,
                                   .scene = {.fps = options.fps, .reference_rate_hz = options.reference_rate_hz},
                                   .seconds = living || options.still_only ? options.seconds : options.still_seconds,
                                   .support = living ? options.support : Support::On,
                                   .log = out / (living ? "services.log" : "services_still.log")};
    if (living) {
      run_options.scene.moving_objects = true;
      run_options.scene.sun_rate_deg_s = options.turning_sun ? options.sun_rate_deg_s : 0;
    }
    return run_dynamics(run_options, signals, still,
                        [&](const std::string& state) { show_state((living ? "living: " : "still: ") + state); });
  };
  std::optional<DynamicsResults> still, living;
  std::string csv = kHeader;
  if (options.still_only || options.still_seconds > 0) {
    still = run(false, nullptr);
    csv += csv_rows("still", *still);
  }
  if (!options.still_only) {
    living = run(true, still ? &still->mean_ssim : nullptr);
    csv += csv_rows("living", *living);
  }
  const DynamicsResults& shown = living ? *living : *still;
  for (std::size_t camera = 0; camera < kDynamicsCameras; ++camera) {
    write_sheet(shown, camera, out / fmt::format("camera_{}.png", camera));
  }
  write_text(out / "figures.csv", csv);
  Json summary = summarize_dynamics(still ? &*still : nullptr, living ? &*living : nullptr);
  summary["seconds"] = options.seconds;
  summary["sun"] = options.turning_sun && !options.still_only ? "turning" : "fixed";
  write_text(out / "summary.json", json_text(summary, 2) + "\n");
  return summary;
}

}  // namespace splatbus::cli
