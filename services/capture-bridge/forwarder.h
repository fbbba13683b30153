#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <utility>

#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/probe_table.h"
#include "capture-bridge/scene_versions.h"
#include "gaussians/light.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge {

/// Publishes what the engine's frames say under the names that the rest of the system reads. Pictures stay in the
/// engine's slab; only the light-space depth map is copied, because it is latched and must outlive the engine's ring.
/// Not thread-safe.
class Forwarder {
 public:
  /// The light's depth is kept in memory of `kind`. Versions of the scene count on from the clock: whoever writes after
  /// another, in its place or anew, begins with a larger number.
  Forwarder(const std::shared_ptr<bus::Context>& context, Device kind);

  /// Of the scene last taken, as the three below. capture/reference: colour, albedo, and depth where there is one, and
  /// who shows where while it masks objects. False when the colour, or that, is not there.
  bool reference(const bus::Message& message, const wire::EngineFrame& frame);
  /// capture/reference with `retire`.
  void retire(const Camera& camera);
  /// capture/probe. False when the colour is gone already.
  bool probe(const bus::Message& message, const wire::EngineFrame& frame, const Probe& probe);
  /// scene/light_depth. False when the depth is gone already. Adds to `host_bytes` what did not stay on the device.
  /// `light_maps`: how many together are the light's.
  bool light_depth(const bus::Message& message, const wire::EngineFrame& frame, std::uint32_t light_maps,
                   std::atomic<std::uint64_t>& host_bytes);
  /// Takes the frame's scene as the one that all that is said belongs to, and publishes scene/state when it differs
  /// from the one before. False for a frame that is older than that scene and of another: its pictures have no version.
  /// With the far field among its objects, where asked for. Throws std::runtime_error, and changes nothing, when the
  /// scene makes no sense.
  [[nodiscard]] bool scene(const wire::EngineFrame& frame, bool with_far_field);
  /// Of an engine that follows: takes the version that shows the same as the one that what is said next belongs to.
  /// False, and changes nothing, when there is none.
  [[nodiscard]] bool follow(const SceneState& scene);

  /// What all that is said belongs to.
  [[nodiscard]] const SceneVersion& shown() const { return shown_; }
  [[nodiscard]] std::uint64_t newest_version() const { return versions_.newest().state->version; }
  [[nodiscard]] const Light& light() const { return versions_.newest().state->light; }
  /// Whether what is shown has objects that are not to be modelled: references then need to say where they show.
  [[nodiscard]] bool masks_objects() const { return masks_objects_; }

 private:
  void show(const SceneVersion& version, std::uint64_t frame, double time_s);

  bus::Publisher publisher_;
  Device kind_;  // of the light's depth
  /// By light and map: what is latched of one stays while others change.
  std::map<std::pair<std::uint32_t, std::uint32_t>, bus::TensorRing> light_depth_rings_;
  std::uint64_t engine_epoch_ = 0;
  std::optional<std::uint64_t> newest_frame_;
  std::vector<std::uint8_t> said_objects_, said_light_;  // bytes of the frame's that were published last
  SceneVersions versions_;
  SceneVersion shown_;
  bool masks_objects_ = false;  // of shown_
  bool said_far_field_ = false;
};

}  // namespace splatbus::capture_bridge
