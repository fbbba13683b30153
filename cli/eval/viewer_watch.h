#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <string>

#include "bus/subscriber.h"
#include "gaussians/camera.h"
#include "metrics/metrics.h"

namespace splatbus::cli {

/// Where each viewer looks from, and how it answered probes. Not thread-safe.
class ViewerWatch {
 public:
  explicit ViewerWatch(std::shared_ptr<bus::Context> context);

  void poll(std::chrono::milliseconds timeout);

  struct Pose {
    Camera camera;
    std::int64_t told_ns = 0;
  };
  struct Answer {
    metrics::Quality quality;
    std::uint64_t gaussians = 0;  ///< in the viewer's replica
    std::int64_t told_ns = 0;
  };
  /// Null before the viewer has told one.
  [[nodiscard]] const Pose* pose(const std::string& viewer) const;
  [[nodiscard]] const Answer* answer(const std::string& viewer, std::uint64_t probe_id) const;

 private:
  bus::Subscriber subscriber_;
  std::map<std::string, Pose> poses_;
  std::map<std::string, std::map<std::uint64_t, Answer>> answers_;
};

}  // namespace splatbus::cli
