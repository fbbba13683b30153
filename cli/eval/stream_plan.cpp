#include "stream_plan.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/gtc/constants.hpp>
#include <memory>
#include <stdexcept>

#include "explore_plan.h"
#include "explore_way.h"
#include "figures.h"
#include "probe_round.h"
#include "viewer/walk_path.h"

namespace splatbus::cli {

namespace {

constexpr int kHeldOutCameras = 4;
constexpr double kStillReferenceRate_hz = 0.5;
constexpr float kFov_degrees = 60;
constexpr double kWalkBudget_kbps = 6000, kWalkViewer_kbps = 9000;  // the streamer's defaults: the launch file has more

void require_service(LaunchFile& file, const char* name) {
  if (file.find(name) == nullptr) throw LaunchError({file.path, 0, 0}, fmt::format("there is no service '{}'", name));
}

void change_launch(const StreamRunOptions& options, std::uint16_t port, LaunchFile& file) {
  require_service(file, "engine");
  require_service(file, "streamer");
  std::erase_if(file.services,
                [](const LaunchService& service) { return service.name == "viewer" || service.name == "gateway"; });
  std::vector<std::string>& engine = file.find("engine")->args;
  set_flag(engine, "--seed", std::to_string(options.setup.seed));
  const std::size_t most = *std::ranges::max_element(options.viewers) + 2;  // and one that joins, and its forerunner
  Settings settings{{"streamer.tcp", fmt::format("tcp://127.0.0.1:{}", port)},
                    {"streamer.max_viewers", std::to_string(std::max<std::size_t>(64, most))}};
  std::optional<double> viewer_kbps = options.viewer_kbps;
  if (!viewer_kbps && options.shape.mbps > 0) viewer_kbps = 0;
  if (options.walk) {
    set_flag(engine, "--scene", "world");
    settings.emplace_back("capture-bridge.reference_rig", "follow");
    settings.emplace_back("streamer.budget_kbps", fmt::format("{}", kWalkBudget_kbps));
    if (!viewer_kbps) viewer_kbps = kWalkViewer_kbps;
  }
  if (viewer_kbps) settings.emplace_back("streamer.viewer_kbps", fmt::format("{}", *viewer_kbps));
  apply_settings(settings, file);
  if (options.still) apply(EngineScene{.reference_rate_hz = kStillReferenceRate_hz}, file);
}

std::function<Camera(double)> walking(const StreamRunOptions& options, const LaunchPlan& launch) {
  const auto engine = std::ranges::find(launch.processes, "engine", &ProcessPlan::name);
  const std::filesystem::path file = options.setup.out / "walk.txt";
  write_text(file, print_walk(*engine));
  const std::vector<viewer::PathLeg> legs = viewer::read_path_points(file);
  if (legs.size() != 1) throw std::runtime_error(file.string() + ": a walk has no teleports");
  const auto path = std::make_shared<viewer::WalkPath>(legs, viewer::WalkPath::Options{.speed_m_s = options.speed_m_s});
  const auto size = static_cast<std::uint32_t>(options.setup.size);
  return [path, size](double seconds) {
    const viewer::WalkPath::Pose pose = path->at(seconds);
    return look_at(pose.eye, pose.eye + pose.forward(), size, size, glm::radians(kFov_degrees));
  };
}

std::function<Camera(double)> orbiting(const StreamRunOptions& options) {
  const int size = options.setup.size;
  const double period_s = options.period_s;
  return [size, period_s](double seconds) {
    const auto degrees = static_cast<float>(360 * std::fmod(seconds / period_s, 1.0));
    return circle_cameras({.count = 1, .size = size, .fov_degrees = kFov_degrees, .phase_degrees = degrees}).front();
  };
}

}  // namespace

StreamPlan plan_stream(const StreamRunOptions& options, const bus::Address& address, std::uint16_t port) {
  StreamPlan plan;
  plan.launch =
      plan_evaluation(options.setup, address, false, [&](LaunchFile& file) { change_launch(options, port, file); });
  if (options.walk) {
    plan.viewer = walking(options, plan.launch);
    return plan;
  }
  plan.viewer = orbiting(options);
  // Half-way between reference cameras.
  plan.held_out = circle_cameras({.count = kHeldOutCameras,
                                  .size = options.setup.size,
                                  .phase_degrees = 180.0F / static_cast<float>(options.setup.cameras)});
  return plan;
}

}  // namespace splatbus::cli
