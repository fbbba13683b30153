#include "viewer/camera_path.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <utility>

#include "bus/error.h"

namespace splatbus::viewer {

namespace {

constexpr double kSteepestFlight = 1.4;  // radians; straight up or down there is no heading

WalkPath::Options walk_options(const PathOptions& options) {
  return {.speed_m_s = options.speed_m_s,
          .turn_s = options.turn_s,
          .pitch_limit_radians = options.kind == PathKind::Fly ? kSteepestFlight : options.pitch_limit_radians,
          .there_and_back = options.there_and_back,
          .loop = options.loop};
}

}  // namespace

void PathOptions::bind(bus::ParameterBinder& p) {
  using bus::kDegrees;
  using bus::kRuntime;
  p.add("width", width, "width of pictures, pixels", {8, 8192});
  p.add("height", height, "height of pictures, pixels", {8, 8192});
  p.add("fov_degrees", fov_radians, "vertical field of view, degrees", {5, 150}, kRuntime, kDegrees);
  p.add("path", kind,
        "camera path without a window: orbit around the target, still at its start, walk along the points of "
        "path_file, fly smoothly through them, or replay a recorded one",
        {{"orbit", PathKind::Orbit},
         {"still", PathKind::Still},
         {"walk", PathKind::Walk},
         {"fly", PathKind::Fly},
         {"recorded", PathKind::Recorded}});
  p.add("radius_m", radius_m, "horizontal distance from the target, m", {0.01, 1e4});
  p.add("height_m", height_m, "height above the world's zero, m", {-1e4, 1e4});
  p.add("period_s", period_s, "time of one orbit, s", {0.1, 1e6});
  p.add("phase_degrees", phase_radians, "start of the orbit, from +x towards +z, degrees", {-360, 360}, kRuntime,
        kDegrees);
  p.add("target_x_m", target_m.x, "x of the point that the camera looks at, m", {-1e4, 1e4});
  p.add("target_y_m", target_m.y, "y of that point, m", {-1e4, 1e4});
  p.add("target_z_m", target_m.z, "z of that point, m", {-1e4, 1e4});
  p.add("path_file", file,
        "file for walk and fly, an eye position 'x y z' per line in m; for recorded, 't x y z qw qx qy qz' per line in "
        "s, world from camera; a line 'teleport' between two makes the camera jump");
  p.add("speed_m_s", speed_m_s, "speed of walk and fly, m/s", {0.001, 1e3});
  p.add("turn_s", turn_s, "time over which walk and fly spread the turn at a point, s", {0, 60});
  p.add("pitch_limit_degrees", pitch_limit_radians, "largest pitch of a walk on stairs, degrees", {0, 80}, kRuntime,
        kDegrees);
  p.add("there_and_back", there_and_back, "lead walk and fly back over their own way");
  p.add("path_end", loop, "what happens at the end of path_file: stay there, or loop",
        {{"stay", false}, {"loop", true}});
  p.add("path_start_s", start_s, "time in the path at which it begins; a change starts it again there, s", {0, 1e9});
  p.add("path_run", run, "let the path's time run; false: the camera stays where it is");
}

CameraPath::CameraPath(const PathOptions& options)
    : options_(options), pinhole_(look_at({0, 0, 0}, {1, 0, 0}, options.width, options.height, options.fov_radians)) {
  if (options_.kind == PathKind::Orbit || options_.kind == PathKind::Still) return;
  if (options_.file.empty()) throw bus::Error("a path along a file needs path_file");
  if (options_.kind == PathKind::Recorded) {
    recorded_ = read_path_poses(options_.file);
    return;
  }
  std::vector<PathLeg> legs = read_path_points(options_.file);
  if (options_.kind == PathKind::Fly) {
    for (PathLeg& leg : legs) leg = spline_points(leg);
  }
  walk_.emplace(std::move(legs), walk_options(options_));
}

Camera CameraPath::at(double seconds) const {
  if (!recorded_.empty()) return recorded_at(seconds);
  if (walk_) {
    const WalkPath::Pose pose = walk_->at(seconds);
    return look_at(pose.eye, pose.eye + pose.forward(), options_.width, options_.height, options_.fov_radians);
  }
  const double turns = options_.kind == PathKind::Orbit ? seconds / options_.period_s : 0;
  const float angle = options_.phase_radians + glm::two_pi<float>() * static_cast<float>(std::fmod(turns, 1.0));
  const glm::vec3& target = options_.target_m;
  const glm::vec3 eye(target.x + options_.radius_m * std::cos(angle), options_.height_m,
                      target.z + options_.radius_m * std::sin(angle));
  return look_at(eye, target, options_.width, options_.height, options_.fov_radians);
}

Camera CameraPath::recorded_at(double seconds) const {
  const double first_s = recorded_.front().front().time_s;
  const double length_s = recorded_.back().back().time_s - first_s;
  double time_s = std::max(0.0, seconds);
  if (options_.loop && length_s > 0) time_s = std::fmod(time_s, length_s);
  time_s += first_s;
  // The leg that has begun last.
  const auto next = std::ranges::upper_bound(recorded_, time_s, {}, [](const auto& leg) { return leg.front().time_s; });
  const std::vector<TimedPose>& leg = *std::prev(next);
  const auto after = std::ranges::upper_bound(leg, time_s, {}, &TimedPose::time_s);
  Camera camera = pinhole_;
  camera.world_from_camera = std::prev(after)->world_from_camera;
  if (after == leg.end()) return camera;
  const TimedPose& before = *std::prev(after);
  const auto part = static_cast<float>((time_s - before.time_s) / (after->time_s - before.time_s));
  const Rigid &a = before.world_from_camera, &b = after->world_from_camera;
  camera.world_from_camera = {.rotation = glm::slerp(a.rotation, b.rotation, part),
                              .translation = glm::mix(a.translation, b.translation, part)};
  return camera;
}

PathClock::PathClock(const PathOptions& options, std::int64_t now_ns, double begin_s)
    : options_(options), before_s_(begin_s), since_ns_(now_ns) {}

void PathClock::change(const PathOptions& options, std::int64_t now_ns) {
  const bool anew =
      options.start_s != options_.start_s || options.kind != options_.kind || options.file != options_.file;
  before_s_ = anew ? options.start_s : seconds(now_ns);
  since_ns_ = now_ns;
  options_ = options;
}

double PathClock::seconds(std::int64_t now_ns) const {
  return before_s_ + (options_.run ? static_cast<double>(now_ns - since_ns_) / 1e9 : 0);
}

}  // namespace splatbus::viewer
