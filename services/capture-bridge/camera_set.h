#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "gaussians/camera.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge {

struct CameraRequest {
  Camera camera;
  wire::EngineBuffer buffers = wire::EngineBuffer::Color;
  float rate_hz = 0;  ///< 0: once for each request_id
  std::uint64_t request_id = 0;
};

/// What engine/cameras says: all cameras that the engine shall render. Request ids grow and are never used twice.
class CameraSet {
 public:
  /// Ids start above `first_request_id`: an engine that outlives this process must not take new requests for old ones.
  explicit CameraSet(std::uint64_t first_request_id) : last_request_id_(first_request_id) {}

  /// Replaces all cameras of a role. Cameras that are as before keep their request, all others get a new request id.
  /// Returns the cameras that have left (their ids are in the set no longer).
  std::vector<Camera> replace(CameraRole role, std::span<const Camera> cameras, wire::EngineBuffer buffers,
                              float rate_hz);

  /// New request ids for these cameras of a role: render them again.
  void reissue(CameraRole role, std::span<const std::uint32_t> ids);
  void reissue_all(CameraRole role);

  /// Adds or replaces one camera; returns its request id.
  std::uint64_t add(const Camera& camera, wire::EngineBuffer buffers, float rate_hz);
  void remove(CameraRole role, std::uint32_t id);

  [[nodiscard]] std::vector<CameraRequest> of_role(CameraRole role) const;
  [[nodiscard]] const std::vector<CameraRequest>& requests() const { return requests_; }

  /// True once after any change.
  bool take_changed();

 private:
  std::uint64_t last_request_id_;
  std::vector<CameraRequest> requests_;
  bool changed_ = true;
};

}  // namespace splatbus::capture_bridge
