#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "capture-bridge/light_rig.h"
#include "capture-bridge/parameters.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/rig.h"

namespace splatbus::capture_bridge {

/// Keeps both rigs where parameters and viewer want them, and the requests that follow from that.
class RigControl {
 public:
  RigControl(const bus::Parameters& parameters, std::uint64_t first_request_id)
      : options_(parameters), cameras_(first_request_id) {}

  /// Places the rigs; `viewer` is null until one is known. With `hold_input` the input rig stays, whatever the viewer
  /// does. Returns the input and reference cameras that have left for good.
  std::vector<Camera> update(const Camera* viewer, const ContentHeights& content, bool hold_input);
  /// Asks for the depth maps of the scene's lights, about where update() has placed the input rig.
  void update_lights(const Light& light);
  /// From the next update() on references show who is where, too.
  void ask_for_ids() { wants_ids_ = true; }

  /// Asks for input frames that are missing, or for all of them, again.
  void reissue_missing_inputs();
  void reissue_inputs();
  /// Asks for depth maps that have never come again.
  void reissue_missing_lights();
  /// Asks for a camera's picture again.
  void reissue(CameraRole role, std::uint32_t camera_id);

  [[nodiscard]] CameraSet& cameras() { return cameras_; }
  [[nodiscard]] InputRound& round() { return round_; }
  [[nodiscard]] LightRig& lights() { return lights_; }

 private:
  void place_inputs(std::vector<Camera>& left);
  void place_references(const Camera* viewer, std::vector<Camera>& left);
  [[nodiscard]] bool viewer_moved(const Camera& viewer) const;

  bus::LiveOptions<Options> options_;
  CameraSet cameras_;
  InputRound round_;
  InputRigTracker tracker_;
  LightRig lights_;
  std::optional<Camera> followed_;  // the viewer that the follow rig was placed for
  bool placed_ = false;
  bool wants_ids_ = false, asks_for_ids_ = false;  ///< of references
};

}  // namespace splatbus::capture_bridge
