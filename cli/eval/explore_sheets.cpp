#include "explore_sheets.h"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <limits>
#include <utility>
#include <vector>

#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "metrics/plot.h"

namespace splatbus::cli {

namespace {

constexpr double kMegabyte = 1e6;
constexpr double kStepWindow_s = 5;  // over which a step's time is taken

/// One figure of a sample, under the name that the CSV's column and the plot's line have.
struct Figure {
  std::string name;
  std::function<std::optional<double>(const ExploreSample&)> get;
};

template <class Member>
Figure of_trainer(const char* name, Member member, double unit = 1) {
  return {name, [=](const ExploreSample& sample) -> std::optional<double> {
            return static_cast<double>(sample.trainer.*member) / unit;
          }};
}

template <class Member>
Figure of_viewer(const std::string& name, Member member, std::size_t viewer) {
  return {name, [=](const ExploreSample& sample) -> std::optional<double> {
            if (viewer >= sample.viewers.size() || !sample.viewers[viewer]) return {};
            return (*sample.viewers[viewer]).*member;
          }};
}

/// The figures by plot: title, and what is drawn in it.
std::vector<std::pair<std::string, std::vector<Figure>>> figures_of(const ExploreResults& results) {
  using Trainer = PipelineState::Trainer;
  const Figure step{"step_ms", [&results](const ExploreSample& sample) {
                      return step_ms(results, {.from_s = sample.time_s - kStepWindow_s, .to_s = sample.time_s + 1e-6});
                    }};
  const Figure draw{"draw_ms", [](const ExploreSample& sample) { return sample.draw_ms; }};
  const Figure resident_mb{"resident_mb", [](const ExploreSample& sample) -> std::optional<double> {
                             return static_cast<double>(sample.resident_bytes) / kMegabyte;
                           }};
  std::vector<Figure> ssim, flip, unmodelled{of_trainer("masked_share", &Trainer::masked_share)};
  const std::size_t viewers = results.samples.empty() ? 1 : results.samples.front().viewers.size();
  for (std::size_t viewer = 0; viewer < viewers; ++viewer) {
    const std::string suffix = viewer == 0 ? "" : fmt::format("_{}", viewer + 1);
    ssim.push_back(of_viewer("ssim" + suffix, &ViewerFigures::ssim, viewer));
    flip.push_back(of_viewer("flip" + suffix, &ViewerFigures::flip, viewer));
    unmodelled.push_back(of_viewer("unmodelled_share" + suffix, &ViewerFigures::unmodelled_share, viewer));
  }
  const auto of_expander = [](const char* name, double Inserted::*reason) {
    return Figure{name, [=](const ExploreSample& sample) -> std::optional<double> { return sample.inserted.*reason; }};
  };
  return {{"Gaussians",
           {of_trainer("gaussians", &Trainer::gaussians), of_trainer("active", &Trainer::active),
            of_trainer("frozen", &Trainer::frozen), of_trainer("spilled", &Trainer::spilled)}},
          {"Gaussians inserted so far",
           {of_expander("inserted_bare", &Inserted::bare), of_expander("inserted_hole", &Inserted::hole),
            of_expander("inserted_fill", &Inserted::fill)}},
          {"pages",
           {of_trainer("pages_active", &Trainer::pages_active), of_trainer("pages_frozen", &Trainer::pages_frozen),
            of_trainer("pages_spilled", &Trainer::pages_spilled)}},
          {"memory, MB",
           {of_trainer("device_mb", &Trainer::device_bytes, kMegabyte),
            {"active_mb", active_mb},
            of_trainer("host_mb", &Trainer::host_bytes, kMegabyte),
            of_trainer("disk_mb", &Trainer::disk_bytes, kMegabyte),
            resident_mb}},
          {"ms: a step of the optimizer, a picture of the viewer", {step, draw}},
          {"views trained a second", {of_trainer("views_per_s", &Trainer::views_per_s)}},
          {"SSIM at the viewer", ssim},
          {"FLIP at the viewer", flip},
          {"share of pixels that nothing models", unmodelled}};
}

}  // namespace

std::optional<double> active_mb(const ExploreSample& sample) {
  if (sample.trainer.device_bytes == 0) return {};
  const std::uint64_t frozen = sample.trainer.pages_frozen * sample.page_bytes;
  return static_cast<double>(sample.trainer.device_bytes - std::min(sample.trainer.device_bytes, frozen)) / kMegabyte;
}

std::string exploration_csv(const ExploreResults& results) {
  const auto plots = figures_of(results);
  std::string text = "time_s,phase,x,y,z";
  for (const auto& [title, figures] : plots) {
    for (const Figure& figure : figures) text += "," + figure.name;
  }
  text += "\n";
  for (const ExploreSample& sample : results.samples) {
    text += fmt::format("{:.3f},{},{:.3f},{:.3f},{:.3f}", sample.time_s, to_string(sample.phase), sample.eye.x,
                        sample.eye.y, sample.eye.z);
    for (const auto& [title, figures] : plots) {
      for (const Figure& figure : figures) {
        const std::optional<double> value = figure.get(sample);
        text += value ? fmt::format(",{:.6g}", *value) : ",";
      }
    }
    text += "\n";
  }
  return text;
}

void write_exploration_plots(const ExploreResults& results, const std::filesystem::path& path) {
  std::vector<metrics::Plot> plots;
  for (const auto& [title, figures] : figures_of(results)) {
    metrics::Plot plot{.title = title,
                       .x_label = "seconds of the walk",
                       .lines = {},
                       .marks = {{results.out_s, "back"}, {results.walk_s, "teleport"}},
                       .y_from = title.starts_with("SSIM") ? 0.5 : 0};
    for (const Figure& figure : figures) {
      metrics::PlotLine line{.name = figure.name, .x = {}, .y = {}};
      for (const ExploreSample& sample : results.samples) {
        line.x.push_back(sample.time_s);
        line.y.push_back(figure.get(sample).value_or(std::numeric_limits<double>::quiet_NaN()));
      }
      plot.lines.push_back(std::move(line));
    }
    plots.push_back(std::move(plot));
  }
  metrics::write_png(path, metrics::draw(plots));
}

void write_exploration_sheet(const ExploreResults& results, const std::vector<ExplorePictures>& chosen,
                             const std::string& title, const std::filesystem::path& path) {
  metrics::ContactSheet sheet{.title = title,
                              .columns = {},
                              .rows = {{.caption = "engine", .figures = {}, .pictures = {}},
                                       {.caption = "viewer", .figures = {}, .pictures = {}}},
                              .picture_height = 192};
  for (const ExplorePictures& pictures : chosen) {
    const ExploreSample& sample = results.samples[pictures.sample];
    sheet.columns.push_back(
        fmt::format("{:.0f} s {}  {:.3f}", sample.time_s, to_string(sample.phase), sample.viewers.front()->ssim));
    sheet.rows[0].pictures.push_back(pictures.engine);
    sheet.rows[1].pictures.push_back(pictures.viewer);
  }
  if (!sheet.columns.empty()) metrics::write_png(path, metrics::draw(sheet));
}

}  // namespace splatbus::cli
