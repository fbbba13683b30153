#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "capture-bridge/free_space.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/viewers.h"

namespace splatbus::capture_bridge {

struct RangeOptions {
  float rate_hz = 2;     ///< cubes of all viewers together; 0: none
  int size = 64;         ///< of a face, pixels square
  float move_m = 0.5F;   ///< a viewer farther from its cube gets another one
  float reach_m = 3.4F;  ///< a cube farther from its viewer is of no use
};

/// Finds the free space about viewers: has the engine render depth cubes where they are, as probes with ids of their
/// own. Bounded: three at once, and then so many a second, and no more than a sixth of
/// the time but for viewers without one of use. Times are
/// CLOCK_MONOTONIC nanoseconds. Not thread-safe.
class RangeFinder {
 public:
  /// Asks for what is due; `cameras` are the ones the engine is told of.
  void update(const RangeOptions& options, const Viewers& viewers, std::int64_t now_ns, CameraSet& cameras);

  /// Whether a camera of role Probe is one of ours.
  [[nodiscard]] static bool owns(std::uint32_t camera_id) { return camera_id >= kFirstId; }
  /// The camera whose picture is waited for; null when it is not.
  [[nodiscard]] const Camera* awaited(std::uint32_t camera_id, std::uint64_t request_id) const;
  /// It has come: metres along z, as many as that camera has pixels.
  void take(std::uint32_t camera_id, std::vector<float> depth_m, std::int64_t now_ns, CameraSet& cameras);

  /// Of a cube near enough to the viewer and in its sight; null when there is none.
  [[nodiscard]] const FreeSpace* about(const std::string& viewer, const glm::vec3& position) const;

 private:
  static constexpr std::uint32_t kFirstId = 0x8000'0000;

  struct Cube {
    std::array<Camera, FreeSpace::kFaces> cameras;
    std::array<std::uint64_t, FreeSpace::kFaces> request_ids{};
    FreeSpace::Depth depth_m;
    std::int64_t asked_ns = 0;
    std::uint64_t jumps = 0;
  };
  struct Range {
    std::uint32_t slot = 0;  ///< camera ids are kFirstId + kFaces times this, and up
    std::optional<FreeSpace> free;
    std::optional<Cube> pending;
    std::int64_t asked_ns = 0;  ///< for a cube, last
  };
  /// How far the viewer is from its cube; without end where it has none of use, and 0 where one is on its way.
  [[nodiscard]] float off_cube(const std::string& name, const Viewer& viewer) const;
  Range& range_of(const std::string& viewer);
  static void cancel(Range& range, CameraSet& cameras);
  void ask(const RangeOptions& options, const Viewer& viewer, Range& range, std::int64_t now_ns, CameraSet& cameras);

  std::map<std::string, Range> ranges_;
  float reach_m_ = 0;
  double credit_ = 0;  // cubes that may be asked for
  std::int64_t credited_ns_ = 0;
  std::int64_t rest_until_ns_ = 0;  // only viewers without a cube of use have one before
};

}  // namespace splatbus::capture_bridge
