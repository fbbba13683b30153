#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "capture-bridge/camera_shares.h"
#include "capture-bridge/parameters.h"
#include "capture-bridge/range_finder.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/viewers.h"

namespace splatbus::capture_bridge {

/// The reference cameras: on a ring, or divided evenly among the viewers, each of whom has the aligned one first; where
/// there are more viewers than cameras, those who came first have them. Times are CLOCK_MONOTONIC nanoseconds. Not
/// thread-safe.
class ReferenceRigs {
 public:
  /// Places the cameras that are due; with `anew` all of them. Returns those that have left for good.
  std::vector<Camera> update(const Options& options, bool anew, wire::EngineBuffer buffers, const Viewers& viewers,
                             const RangeFinder& ranges, std::int64_t now_ns, CameraSet& cameras);
  /// A camera's picture has come.
  void arrived(std::uint32_t camera_id);

 private:
  struct Standing {
    Camera camera;
    bool pending =
        false;  ///< its picture is on its way: it stays so long, or an engine that is slow would never show it
    std::int64_t asked_ns = 0;
    bool hurried = false;  ///< it went on without that picture, for its viewer has jumped
  };
  [[nodiscard]] std::vector<Camera> wanted(const Options& options, const Viewers& viewers, const RangeFinder& ranges);

  CameraShares shares_;
  std::map<std::uint32_t, Standing> standing_;  // cameras that follow, by id
  bool follows_ = false;
};

}  // namespace splatbus::capture_bridge
