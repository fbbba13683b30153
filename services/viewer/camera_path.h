#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "bus/parameters.h"
#include "gaussians/camera.h"
#include "viewer/path_file.h"
#include "viewer/walk_path.h"

namespace splatbus::viewer {

enum class PathKind : std::uint8_t {
  Orbit,     ///< about the target, once a period
  Still,     ///< where the orbit begins
  Walk,      ///< along the points of a file
  Fly,       ///< along a smooth curve through them
  Recorded,  ///< as a file of timed poses says
};

/// What the viewer's camera does when there is no window to steer it.
struct PathOptions {
  std::uint32_t width = 256, height = 256;
  float fov_radians = 1.0471976F;  ///< vertical
  PathKind kind = PathKind::Orbit;
  float radius_m = 4;  ///< from the target, level
  float height_m = 2;  ///< above the world's zero
  double period_s = 30;
  float phase_radians = 0;  ///< where the orbit begins, from +x towards +z
  glm::vec3 target_m{0, 0.4F, 0};
  std::string file;
  double speed_m_s = 1.4;
  double turn_s = 1;
  double pitch_limit_radians = 0.5235987756;
  bool there_and_back = false, loop = false;
  double start_s = 0;
  bool run = true;

  void bind(bus::ParameterBinder& parameters);
  bool operator==(const PathOptions&) const = default;
};

/// The viewer's camera by the time of its path.
class CameraPath {
 public:
  /// Reads the file where the path has one. Throws bus::Error that names the file, and the line that is wrong.
  explicit CameraPath(const PathOptions& options);

  [[nodiscard]] Camera at(double seconds) const;

 private:
  [[nodiscard]] Camera recorded_at(double seconds) const;

  PathOptions options_;
  Camera pinhole_;
  std::optional<WalkPath> walk_;
  std::vector<std::vector<TimedPose>> recorded_;
};

/// A path's own time: it begins at start_s, or where another viewer's has ended, goes on while `run` says so, and
/// begins anew where a changed start_s or another way says so.
class PathClock {
 public:
  PathClock(const PathOptions& options, std::int64_t now_ns, double begin_s);
  PathClock(const PathOptions& options, std::int64_t now_ns) : PathClock(options, now_ns, options.start_s) {}

  void change(const PathOptions& options, std::int64_t now_ns);
  [[nodiscard]] double seconds(std::int64_t now_ns) const;

 private:
  PathOptions options_;
  double before_s_;  ///< until since_ns_
  std::int64_t since_ns_;
};

}  // namespace splatbus::viewer
