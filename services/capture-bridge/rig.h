#pragma once

#include <glm/glm.hpp>
#include <span>
#include <string>
#include <vector>

#include "gaussians/camera.h"

namespace splatbus::capture_bridge {

/// Of a picture, in pixels.
struct PictureSize {
  int width = 0, height = 0;

  constexpr PictureSize(int side = 0) : width(side), height(side) {}  // NOLINT: a number is a square's side
  constexpr PictureSize(int columns, int rows) : width(columns), height(rows) {}
  [[nodiscard]] std::size_t pixels() const {
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  }
  bool operator==(const PictureSize&) const = default;
};

/// "WxH", or one number for a square; each from `minimum` to `maximum`. False when it is anything else.
[[nodiscard]] bool parse_size(const std::string& text, int minimum, int maximum, PictureSize& size);

struct DomeOptions {
  int cameras = 24;
  PictureSize size = 128;
  float fov_radians = 1.0471976F;  ///< vertical
  float radius_m = 3.4F;
};

/// The upper part of a Fibonacci sphere about `centre`: `cameras` cameras on it that look at the centre, evenly over
/// the cap from just above the horizon to the zenith, turned about y with the heading. Ids 0, 1, ... are stable.
[[nodiscard]] std::vector<Camera> dome_cameras(const DomeOptions& options, const glm::vec3& centre,
                                               float heading_radians);

struct RingOptions {
  int cameras = 8;
  PictureSize size = 160;
  float fov_radians = 1.0471976F;  ///< vertical
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
  PictureSize size = 160;
  float fov_radians = 1.0471976F;      ///< vertical
  bool viewers_picture = false;        ///< shape and field of view are the viewer's, with as many pixels as `size`
  float margin = 1.1F;                 ///< then the tangents of half its angles, times this
  float side_m = 0.6F;                 ///< how far the side cameras stand from the viewer, the first pair
  float above_m = 0.6F;                ///< how far above the viewer the upper camera stands
  float toe_in_radians = 0.12217305F;  ///< side cameras turn towards the viewer's axis, the upper one down
};

/// Cameras that follow the viewer (paper, "Moving cameras"): 0 is aligned with it, 1 and 2 stand at its left and right,
/// 3 above; further ones continue left, right, above at growing offsets. Ids 0, 1, ...
[[nodiscard]] std::vector<Camera> follow_cameras(const FollowOptions& options, const Camera& viewer);

/// Where the dome stands for a viewer, and when it follows.
struct DomePlacement {
  float focus_m = 3.4F;             ///< distance of its centre in front of the viewer
  float lead_s = 0.5F;              ///< it is placed for where the viewer will be after that time
  float move_m = 0.5F;              ///< it stays until its centre is off by more ...
  float turn_radians = 1.0471976F;  ///< ... or the heading has turned by more than this
  int about = 5;                    ///< cameras that look about from where the viewer will be, if there are many
  bool fixed_centre = false;
  glm::vec3 centre{0, 0.25F, 0};  ///< the place of interest: the centre when fixed, and until a viewer is known
};

/// "x,y,z" in metres. False when it is anything else.
[[nodiscard]] bool parse_point(const std::string& text, glm::vec3& point);

}  // namespace splatbus::capture_bridge
