#pragma once

#include <glm/glm.hpp>
#include <span>
#include <string>
#include <vector>

#include "gaussians/camera.h"

namespace splatbus::capture_bridge {

/// Where the viewer is and where it looks.
struct ViewerState {
  glm::vec3 position{0};
  glm::vec3 forward{0, 0, -1};  ///< unit, world

  /// From any camera: its position and its z axis.
  static ViewerState of(const Camera& camera);
  /// Angle about world y, radians, 0 looking along -z. Keeps `fallback` where the viewer looks straight up or down.
  [[nodiscard]] float heading(float fallback = 0) const;
};

struct DomeOptions {
  int cameras = 24;
  int size = 128;  ///< pixels, square
  float fov_radians = 1.0471976F;
  float radius_m = 3.4F;
};

/// The upper part of a Fibonacci sphere about `centre`: `cameras` cameras on it that look at the centre, evenly over
/// the cap from just above the horizon to the zenith, turned about y with the heading. Ids 0, 1, ... are stable.
[[nodiscard]] std::vector<Camera> dome_cameras(const DomeOptions& options, const glm::vec3& centre,
                                               float heading_radians);

struct RingOptions {
  int cameras = 8;
  int size = 160;
  float fov_radians = 1.0471976F;
  float radius_m = 3.4F;
  float height_m = 1.6F;  ///< above world y = 0
  float phase_radians = 0;
  glm::vec3 target{0, 0.25F, 0};
};

/// A circle about the target's vertical axis. Camera i stands at angle phase + 2 pi i / cameras, counted from +x
/// towards +z, and looks at the target.
[[nodiscard]] std::vector<Camera> ring_cameras(const RingOptions& options);

struct FollowOptions {
  int cameras = 4;
  int size = 160;
  float fov_radians = 1.0471976F;
  float side_m = 0.6F;                 ///< how far the side cameras stand from the viewer, the first pair
  float above_m = 0.6F;                ///< how far above the viewer the upper camera stands
  float toe_in_radians = 0.12217305F;  ///< side cameras turn towards the viewer's axis, the upper one down
};

/// Cameras that follow the viewer (paper, "Moving cameras"): 0 is aligned with it, 1 and 2 stand at its left and right,
/// 3 above; further ones continue left, right, above at growing offsets.
[[nodiscard]] std::vector<Camera> follow_cameras(const FollowOptions& options, const Camera& viewer);

/// Heights between which most content was found; clamps the dome's centre.
struct ContentHeights {
  float low_m = -1e9F, high_m = 1e9F;
};

/// Decides when the input rig moves, so that a still scene is not captured again and again.
class InputRigTracker {
 public:
  struct Options {
    float focus_m = 3.4F;             ///< distance of the focus in front of the viewer
    float move_m = 0.5F;              ///< the rig stays until the focus has moved farther than this ...
    float turn_radians = 1.0471976F;  ///< ... or the heading has turned by more than this
    bool fixed_centre = false;
    glm::vec3 centre{0, 0.25F, 0};  ///< the centre when fixed, and until a viewer is known
  };

  struct Pose {
    glm::vec3 centre{0};
    float heading_radians = 0;
  };

  /// Where the rig stands for this viewer (null: none known yet). True when it has moved, which the first call has.
  bool update(const Options& options, const ViewerState* viewer, const ContentHeights& content);

  [[nodiscard]] const Pose& pose() const { return pose_; }

 private:
  bool placed_ = false;
  Pose pose_;
};

/// "x,y,z" in metres. False when it is anything else.
[[nodiscard]] bool parse_point(const std::string& text, glm::vec3& point);

}  // namespace splatbus::capture_bridge
