#pragma once

#include <fstream>
#include <glm/glm.hpp>
#include <string>
#include <vector>

#include "gaussians/camera.h"

namespace splatbus::viewer {

/// Points between two teleports, metres in the world; at least one.
using PathLeg = std::vector<glm::vec3>;

/// A text file of eye positions, `x y z` a line in metres. `#` begins a comment, empty lines mean nothing, and a line
/// `teleport` parts two legs. Throws bus::Error that names file and line where it says something else.
[[nodiscard]] std::vector<PathLeg> read_path_points(const std::string& file);

/// Where a camera was, and when.
struct TimedPose {
  double time_s = 0;
  Rigid world_from_camera;
};

/// The same with orientations, `t x y z qw qx qy qz` a line: seconds that rise, a unit quaternion, world from camera.
[[nodiscard]] std::vector<std::vector<TimedPose>> read_path_poses(const std::string& file);

/// Writes such a file line by line.
class PathRecorder {
 public:
  /// Begins the file anew. Throws bus::Error that names it.
  explicit PathRecorder(const std::string& file);
  /// Nothing where the time has not risen since the last.
  void add(const TimedPose& pose);

 private:
  std::string file_;
  std::ofstream out_;
  double last_s_ = -1;
};

}  // namespace splatbus::viewer
