#include "relight_evaluation.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "figures.h"
#include "metrics/contact_sheet.h"
#include "metrics/image_io.h"
#include "parameter_query.h"
#include "scene_view.h"
#include "schema_json.h"
#include "staged_training.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr float kSameDirection = 1e-4F;  ///< distance of unit vectors
constexpr std::int64_t kAskNs = 1'000'000'000;

class RelightEvaluation {
 public:
  RelightEvaluation(const RelightEvaluationOptions& options, const StopSignals& signals,
                    const std::function<void(const std::string&)>& show_state)
      : options_(options),
        training_(options.setup,
                  circle_cameras({.count = options.views,
                                  .size = options.setup.size,
                                  .phase_degrees = 180.0F / static_cast<float>(options.setup.cameras)}),
                  signals, show_state),
        depths_(training_.context()),
        view_(0) {
    sheet_.title = fmt::format("held-out camera 0 after {} steps under the first sun", options.iterations);
    sheet_.columns = {"engine", "server", "FLIP"};
  }

  Json run() {
    depths_.keep(true);
    training_.prepare();
    first_sun_ = training_.held_out().pictures().begin()->second.scene.light.sun_direction;
    training_.train_until(static_cast<std::uint64_t>(options_.iterations));
    send_control(training_.publisher(), "trainer", {{"paused", "true"}});
    Json suns = Json::array();
    const double own = show_sun(0, suns);
    std::vector<double> others;
    for (const double turn_deg : options_.turns_deg) others.push_back(show_sun(turn_deg, suns));
    const FigureSummary night = show_night();
    const auto& trainer = training_.state().trainer;
    if (trainer.step != static_cast<std::uint64_t>(options_.iterations)) {
      throw std::runtime_error(fmt::format("the trainer went on to step {}", trainer.step));
    }
    double sum = 0;
    for (const double ssim : others) sum += ssim;
    Json summary{{"ssim_own", rounded(own)},
                 {"ssim_mean", others.empty() ? Json() : Json(rounded(sum / static_cast<double>(others.size())))},
                 {"ssim_min", others.empty() ? Json() : Json(rounded(*std::ranges::min_element(others)))},
                 {"ssim_point_lights", rounded(night.mean.ssim)},
                 {"flip_point_lights", rounded(night.mean.flip)},
                 {"suns", suns},
                 {"gaussians", trainer.gaussians},
                 {"iterations", trainer.step},
                 {"views", options_.views}};
    write_text(options_.setup.out / "summary.json", json_text(summary, 2) + "\n");
    metrics::write_png(options_.setup.out / "contact_sheet.png", metrics::draw(sheet_));
    training_.stop();
    return summary;
  }

 private:
  /// Mean SSIM over the held-out views under a sun that is so far from the first one.
  double show_sun(double turn_deg, Json& suns) {
    const glm::vec3 wanted = turned(first_sun_, turn_deg);
    wait_for(fmt::format("the sun {} degrees away", turn_deg),
             {{"sun_azimuth_deg", fmt::format("{}", azimuth_deg(first_sun_) + turn_deg)}},
             [&](const Light& light) { return glm::distance(light.sun_direction, wanted) < kSameDirection; });
    const std::string caption = turn_deg == 0 ? std::string("its own sun") : fmt::format("{:.0f} degrees", turn_deg);
    const FigureSummary summary = compare_views(caption);
    suns.push_back({{"turn_deg", turn_deg},
                    {"ssim", rounded(summary.mean.ssim)},
                    {"psnr", rounded(summary.mean.psnr_db)},
                    {"flip", rounded(summary.mean.flip)}});
    return summary.mean.ssim;
  }

  /// No sun, and two point lights that move over the scene. Their lamps are not shown: nothing was learned of them.
  FigureSummary show_night() {
    wait_for("a night with two point lights", {{"night", "1"}, {"lamps_shown", "0"}, {"point_lights", "2"}},
             [](const Light& light) { return light.sun_irradiance == glm::vec3(0) && light.sources.size() == 2; });
    return compare_views("two point lights");
  }

  /// Tells the engine, and waits for held-out pictures and depth maps under a light that is as wanted.
  void wait_for(const std::string& what, const std::vector<std::pair<std::string, std::string>>& changes,
                const std::function<bool(const Light&)>& wanted) {
    std::int64_t asked_ns = 0;
    const auto there = [&] {
      if (lit_by(wanted)) return true;
      if (bus::now_ns() - asked_ns > kAskNs) {
        send_control(training_.publisher(), "engine-sim", changes);
        training_.ask_held_out();
        asked_ns = bus::now_ns();
      }
      return false;
    };
    training_.wait_until(what, there, [&] { return "waits for " + what; });
  }

  FigureSummary compare_views(const std::string& caption) {
    ViewFigures figures;
    for (const auto& [camera, probe] : training_.held_out().pictures()) {
      const SceneLights& lights = lights_.at(camera).second;
      std::optional<cv::Mat> picture;
      // What appears, a lamp say, is inserted all the same: then the model is drawn again.
      training_.wait_until(
          "a model that holds still",
          [&, &probe = probe] {
            picture = view_.render(training_.live(), probe.camera, probe.scene, &lights);
            return picture.has_value();
          },
          [] { return std::string("draws"); });
      figures[camera] = metrics::compare(*picture, probe.picture);
      if (camera == 0) add_to_sheet(caption, probe.picture, *picture, figures[camera]);
    }
    return summarize(figures);
  }

  /// Whether every held-out picture has come under such a light, and the depth maps of it as well.
  [[nodiscard]] bool lit_by(const std::function<bool(const Light&)>& wanted) {
    // Kept as they come: depth maps go within a few frames.
    for (const auto& [camera, probe] : training_.held_out().pictures()) {
      const auto known = lights_.find(camera);
      if (known != lights_.end() && known->second.first == probe.probe_id) continue;
      lights_.erase(camera);
      if (auto lights = depths_.find(probe.scene)) lights_.emplace(camera, std::pair(probe.probe_id, *lights));
    }
    return training_.held_out().complete() &&
           std::ranges::all_of(training_.held_out().pictures(), [&](const auto& entry) {
             const auto lights = lights_.find(entry.first);
             return wanted(entry.second.scene.light) && lights != lights_.end() &&
                    lights->second.first == entry.second.probe_id;
           });
  }

  void add_to_sheet(const std::string& caption, const cv::Mat& engine, const cv::Mat& drawn,
                    const metrics::Quality& quality) {
    cv::Mat map;
    static_cast<void>(metrics::flip(drawn, engine, metrics::kFlipPixelsPerDegree, &map));
    sheet_.rows.push_back(
        {.caption = caption,
         .figures = {fmt::format("SSIM {:.3f}", quality.ssim), fmt::format("PSNR {:.1f}", quality.psnr_db),
                     fmt::format("FLIP {:.3f}", quality.flip)},
         .pictures = {engine, drawn, metrics::colorize(map)}});
  }

  const RelightEvaluationOptions& options_;
  StagedTraining training_;
  LightDepths depths_;
  std::map<std::size_t, std::pair<std::uint64_t, SceneLights>> lights_;  ///< by camera: of which probe, and its lights
  SceneView view_;
  glm::vec3 first_sun_{0};
  metrics::ContactSheet sheet_;
};

}  // namespace

Json run_relight_evaluation(const RelightEvaluationOptions& options, const StopSignals& signals,
                            const std::function<void(const std::string&)>& show_state) {
  fs::create_directories(options.setup.out);
  return RelightEvaluation(options, signals, show_state).run();
}

double azimuth_deg(const glm::vec3& direction) {
  return glm::degrees(std::atan2(static_cast<double>(direction.z), static_cast<double>(direction.x)));
}

glm::vec3 turned(const glm::vec3& direction, double degrees) {
  const double cosine = std::cos(glm::radians(degrees)), sine = std::sin(glm::radians(degrees));
  return {static_cast<float>(direction.x * cosine - direction.z * sine), direction.y,
          static_cast<float>(direction.x * sine + direction.z * cosine)};
}

}  // namespace splatbus::cli
