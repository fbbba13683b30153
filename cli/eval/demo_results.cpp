#include "demo_results.h"

#include <fmt/format.h>

#include <algorithm>
#include <exception>
#include <utility>

#include "figures.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "schema_json.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

bool is_stale(const DemoResults& results, const DemoResults::ViewerAnswer& answer) {
  return answer.probe_id < results.last_round.first_id;
}

/// The viewer's picture of a probe; empty when there is none that can be read.
cv::Mat viewer_picture(const fs::path& viewer_pictures, std::uint64_t probe_id, const cv::Size& size) {
  try {
    cv::Mat picture = metrics::read_png(viewer_pictures / fmt::format("probe_{}_viewer.png", probe_id));
    if (picture.size() == size) return picture;
  } catch (const std::exception&) {
    // The viewer was killed while it wrote it.
  }
  return {};
}

metrics::ContactSheetRow sheet_row(const DemoResults& results, std::size_t camera, const fs::path& viewer_pictures) {
  const DemoResults::Compared& compared = results.compared.at(camera);
  metrics::ContactSheetRow row{.caption = fmt::format("camera {}", camera),
                               .figures = {fmt::format("server SSIM {:.3f}", compared.server.ssim),
                                           fmt::format("PSNR {:.1f} dB", compared.server.psnr_db)},
                               .pictures = {compared.engine, compared.drawn}};
  cv::Mat picture;
  if (const auto answer = results.viewer.find(camera); answer != results.viewer.end()) {
    const metrics::Quality& quality = answer->second.quality;
    row.figures.push_back(fmt::format("viewer SSIM {:.3f}", quality.ssim));
    row.figures.push_back(fmt::format("PSNR {:.1f} dB", quality.psnr_db));
    row.figures.push_back(fmt::format("FLIP {:.3f}", quality.flip));
    if (is_stale(results, answer->second)) row.figures.emplace_back("(earlier round)");
    picture = viewer_picture(viewer_pictures, answer->second.probe_id, compared.engine.size());
  } else {
    row.figures.emplace_back("viewer: no answer");
  }
  cv::Mat map;
  if (!picture.empty()) static_cast<void>(metrics::flip(picture, compared.engine, metrics::kFlipPixelsPerDegree, &map));
  row.pictures.push_back(picture);
  row.pictures.push_back(map.empty() ? map : metrics::colorize(map));
  return row;
}

}  // namespace

void write_contact_sheet(const DemoResults& results, const DemoOptions& options, const fs::path& viewer_pictures) {
  metrics::ContactSheet sheet{.title = fmt::format("splatbus demo, {:.0f} s: held-out cameras", options.seconds),
                              .columns = {"engine", "server", "viewer", "FLIP (viewer)"},
                              .rows = {}};
  for (const auto& [camera, compared] : results.compared) {
    sheet.rows.push_back(sheet_row(results, camera, viewer_pictures));
  }
  metrics::write_png(options.out / "contact_sheet.png", metrics::draw(sheet));
}

Json summarize_demo(const DemoResults& results, const DemoOptions& options, const std::string& log_path) {
  ViewFigures server, viewer;
  for (const auto& [camera, compared] : results.compared) server[camera] = compared.server;
  for (const auto& [camera, answer] : results.viewer) viewer[camera] = answer.quality;
  const metrics::Quality at_server = summarize(server).mean;
  Json summary{{"first_picture_s", nullptr},
               {"gaussians", results.gaussians},
               {"ssim_server", rounded(at_server.ssim)},
               {"psnr_server", rounded(at_server.psnr_db)},
               {"flip_server", rounded(at_server.flip)},
               {"ssim_viewer", nullptr},
               {"psnr_viewer", nullptr},
               {"flip_viewer", nullptr},
               {"steps_per_s", rounded(results.steps_per_s)},
               {"wire_mbps_mean", rounded(results.wire_mbps_mean)},
               {"wire_mbps_peak", rounded(results.wire_mbps_peak)},
               {"seconds", options.seconds},
               {"seed", options.seed},
               {"cameras", results.cameras}};
  if (!viewer.empty()) {
    const metrics::Quality at_viewer = summarize(viewer).mean;
    summary["ssim_viewer"] = rounded(at_viewer.ssim);
    summary["psnr_viewer"] = rounded(at_viewer.psnr_db);
    summary["flip_viewer"] = rounded(at_viewer.flip);
  }
  if (results.first_picture_s) summary["first_picture_s"] = rounded(*results.first_picture_s);
  const auto answered = static_cast<std::size_t>(
      std::ranges::count_if(results.viewer, [&](const auto& entry) { return !is_stale(results, entry.second); }));
  if (results.last_round.compared < results.cameras || answered < results.cameras) {
    summary["note"] = fmt::format(
        "of {} held-out views, {} of the last round were compared at the server and {} at the viewer within {} s; "
        "the figures are of {} and {} views, older ones where the last did not come; see {}",
        results.cameras, results.last_round.compared, answered, results.last_round.timeout_s, server.size(),
        viewer.size(), log_path);
  }
  return summary;
}

}  // namespace splatbus::cli
