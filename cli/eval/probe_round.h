#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "gaussians/light.h"

namespace splatbus::cli {

/// The engine's own picture of a camera that was asked for, with the scene of that very frame.
struct ProbePicture {
  std::uint64_t probe_id = 0;
  Camera camera;
  SceneState scene;
  double time_s = 0;  ///< engine time
  cv::Mat picture;    ///< CV_8UC3 BGR
  cv::Mat object_id;  ///< CV_32SC1, the ids' bits; empty where the engine gave none
  cv::Mat depth;      ///< CV_32FC1, metres, 0 where there is no surface; empty where the engine gave none
};

/// What a capture/probe says, whoever asked; nullopt when its color is gone. Throws bus::Error when it makes no sense.
[[nodiscard]] std::optional<ProbePicture> to_probe_picture(const bus::Message& message);

/// Held-out cameras: asks the engine for their pictures by viewer/probe, and gathers capture/probe. Each round has new
/// probe ids, begin() ... begin() + size - 1. Not thread-safe.
class ProbeRounds {
 public:
  static constexpr std::size_t kMaxCameras = 256;

  ProbeRounds(const std::shared_ptr<bus::Context>& context, std::vector<Camera> cameras);

  void begin();  ///< the next round: asks for every camera
  /// A round of the first `count` of them alone.
  void begin(std::size_t count);
  /// The next round is of other cameras, kMaxCameras at most, and so are those after it.
  void begin(std::vector<Camera> cameras);
  void ask_again(std::size_t camera);

  /// Takes in pictures that have arrived; `handle(index, picture)` for each camera's first of this round.
  void poll(std::chrono::milliseconds timeout, const std::function<void(std::size_t, const ProbePicture&)>& handle);

  [[nodiscard]] std::uint64_t first_id() const { return first_id_; }
  /// The camera that a probe of this or an earlier round was of; nullopt for somebody else's.
  [[nodiscard]] std::optional<std::size_t> camera_of(std::uint64_t probe_id) const;
  [[nodiscard]] const std::map<std::size_t, ProbePicture>& pictures() const { return pictures_; }
  [[nodiscard]] bool complete() const { return first_id_ != 0 && pictures_.size() == asked_; }
  [[nodiscard]] const std::vector<Camera>& cameras() const { return cameras_; }

 private:
  void ask(std::size_t index);

  std::vector<Camera> cameras_;
  bus::Publisher publisher_;
  bus::Subscriber answers_;
  std::uint64_t first_id_ = 0, next_id_;
  const std::uint64_t oldest_id_;
  std::size_t asked_ = 0;  ///< cameras of this round
  std::map<std::size_t, ProbePicture> pictures_;
};

/// A circle about `target`: camera i at angle phase + 2 pi i / count from +x
/// towards +z.
struct Circle {
  int count = 4;
  int size = 160;  ///< pixels, square
  float fov_degrees = 60;
  float radius_m = 3.4F;
  float height_m = 1.6F;
  float phase_degrees = 0;
  glm::vec3 target{0, 0.25F, 0};
};

[[nodiscard]] std::vector<Camera> circle_cameras(const Circle& circle);

/// The capture-bridge's parameters that put its reference cameras on the circle.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> ring_parameters(const Circle& circle);

}  // namespace splatbus::cli
