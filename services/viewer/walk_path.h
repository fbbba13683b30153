#pragma once

#include <cstddef>
#include <glm/glm.hpp>
#include <vector>

#include "viewer/path_file.h"

namespace splatbus::viewer {

/// Along polylines at one speed, looking along the way. A turn is spread over the time before and after its corner;
/// between two legs the walker is elsewhere at once.
class WalkPath {
 public:
  struct Options {
    double speed_m_s = 1.4;
    double turn_s = 1;                 ///< over which a corner's turn is spread; 0: none
    double pitch_limit_radians = 0.5;  ///< up and down
    bool there_and_back = false;       ///< the legs, then all the way back
    bool loop = false;                 ///< from the beginning again, else the walker stays at the end
  };
  struct Pose {
    glm::vec3 eye{0};
    double yaw_radians = 0;  ///< from +x towards +z, over all turns: it goes on beyond a whole one
    double pitch_radians = 0;
    [[nodiscard]] glm::vec3 forward() const;
  };

  WalkPath(std::vector<PathLeg> legs, const Options& options);

  [[nodiscard]] Pose at(double seconds) const;
  /// Of the whole way, there and back where it leads back.
  [[nodiscard]] double length_m() const { return ends_m_.back(); }
  [[nodiscard]] double duration_s() const { return length_m() / options_.speed_m_s; }

 private:
  /// A polyline by arc length. Directions of segment i hold from point i to the next.
  struct Leg {
    PathLeg points;
    std::vector<double> at_m;                          ///< of points
    std::vector<double> yaw, pitch;                    ///< of segments
    std::vector<double> yaw_integral, pitch_integral;  ///< over the way from the leg's start, at points
    bool closed = false;                               ///< its end leads on to its start
    double closing_turn = 0;                           ///< yaw of a whole round

    [[nodiscard]] double length_m() const { return at_m.back(); }
    [[nodiscard]] std::size_t segment(double way_m) const;
    [[nodiscard]] double integral(const std::vector<double>& direction, const std::vector<double>& sums, double turn,
                                  double way_m) const;
  };

  [[nodiscard]] Leg make_leg(const PathLeg& points, double yaw_before) const;
  [[nodiscard]] Pose pose_at(const Leg& leg, double way_m) const;

  Options options_;
  std::vector<Leg> legs_;
  std::vector<double> ends_m_;  ///< of legs, from the start of the way
};

/// Points of a smooth curve through `points`, so close that their polyline stands for it: the centripetal Catmull-Rom
/// spline, which neither overshoots into cusps nor crosses itself within a span (Yuksel, Schaefer, Keyser 2011,
/// "Parameterization and applications of Catmull-Rom curves"), by the pyramid of Barry and Goldman 1988.
[[nodiscard]] PathLeg spline_points(const PathLeg& points);

}  // namespace splatbus::viewer
