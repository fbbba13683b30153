#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <glm/glm.hpp>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <vector>

#include "gaussians/camera.h"
#include "viewer/path_file.h"

namespace splatbus::cli {

/// A stretch of a polyline by arc length, from its end where it is too short.
[[nodiscard]] viewer::PathLeg stretch(const viewer::PathLeg& way, double from_m, double length_m);
[[nodiscard]] double length_m(const viewer::PathLeg& way);

enum class ExplorePhase : std::uint8_t { Out, Back, Teleported };

[[nodiscard]] const char* to_string(ExplorePhase phase);

/// A walk out, some of the way back over its own path, then to the start at once, where the walker stays. Times are of
/// the walk, which is at one speed.
class ExploreWay {
 public:
  /// Starts `from_m` along `way`, which is long enough or the walker turns at its end. Throws std::runtime_error where
  /// nothing is left of it.
  ExploreWay(const viewer::PathLeg& way, double from_m, double out_s, double back_s, double speed_m_s);

  [[nodiscard]] double out_s() const { return length_m(out_) / speed_m_s_; }
  [[nodiscard]] double walk_s() const { return out_s() + length_m(back_) / speed_m_s_; }
  [[nodiscard]] ExplorePhase phase(double time_s) const;
  [[nodiscard]] const glm::vec3& start() const { return out_.front(); }
  /// For a viewer's path_file.
  [[nodiscard]] std::string path_text() const;

 private:
  viewer::PathLeg out_, back_;
  double speed_m_s_;
};

/// Cameras that a walker left behind on the way out, each judged twice from the same distance: when it has gone so far
/// beyond, and when it comes back to there.
class Stations {
 public:
  static constexpr double kEvery_m = 5, kReach_m = 8;

  struct Station {
    Camera camera;
    std::optional<double> left, back;  ///< SSIM
  };

  /// Takes the walker's present camera in, and returns the stations that are to be judged now, each once a phase.
  [[nodiscard]] std::vector<std::size_t> pass(ExplorePhase phase, const Camera& walker);
  void judge(std::size_t station, ExplorePhase phase, double ssim);

  [[nodiscard]] const std::vector<Station>& all() const { return stations_; }
  /// Of the stations that were judged both times; nullopt without any.
  struct Means {
    double left = 0, back = 0;
    std::size_t stations = 0;
  };
  [[nodiscard]] std::optional<Means> means() const;

 private:
  std::vector<Station> stations_;
  std::vector<bool> asked_left_, asked_back_;
};

/// Share of a picture's pixels where the engine shows a surface (depth above 0) and Gaussians hide less than half of
/// what lies behind. `alpha` is CV_8UC3 or CV_8UC1, `depth_m` CV_32FC1, both of one size.
[[nodiscard]] double unmodelled_share(const cv::Mat& alpha, const cv::Mat& depth_m);

}  // namespace splatbus::cli
