#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/probe_table.h"
#include "gaussians/light.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge {

/// Publishes what the engine's frames say under the names that the rest of the system reads. Pictures stay in the
/// engine's slab; only the light-space depth map is copied, because it is latched and must outlive the engine's ring.
/// Not thread-safe.
class Forwarder {
 public:
  /// The light's depth is kept in memory of `kind`.
  Forwarder(const std::shared_ptr<bus::Context>& context, Device kind);

  /// capture/reference: colour, albedo, and depth where there is one. False when the colour is gone already.
  bool reference(const bus::Message& message, const wire::EngineFrame& frame);
  /// capture/reference with `retire`.
  void retire(const Camera& camera);
  /// capture/probe. False when the colour is gone already.
  bool probe(const bus::Message& message, const wire::EngineFrame& frame, const Probe& probe);
  /// scene/light_depth. False when the depth is gone already. Adds to `host_bytes` what did not stay on the device.
  bool light_depth(const bus::Message& message, const wire::EngineFrame& frame, std::atomic<std::uint64_t>& host_bytes);
  /// scene/objects and scene/light, when this frame is the engine's newest and they differ from what was said last.
  void scene(const wire::EngineFrame& frame);

 private:
  bus::Publisher publisher_;
  Device kind_;  // of the light's depth
  bus::TensorRing light_depth_ring_;
  std::uint64_t engine_epoch_ = 0;
  std::optional<std::uint64_t> newest_frame_;
  std::vector<std::uint8_t> said_objects_, said_light_;  // bytes of the frame's that were published last
  Light last_light_;
};

}  // namespace splatbus::capture_bridge
