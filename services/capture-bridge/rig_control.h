#pragma once

#include <cstdint>
#include <vector>

#include "capture-bridge/input_rigs.h"
#include "capture-bridge/light_rig.h"
#include "capture-bridge/parameters.h"
#include "capture-bridge/range_finder.h"
#include "capture-bridge/reference_rigs.h"
#include "capture-bridge/requests.h"
#include "capture-bridge/viewers.h"

namespace splatbus::capture_bridge {

/// Keeps all rigs where parameters and viewers want them, and the requests that follow from that. Times are
/// CLOCK_MONOTONIC nanoseconds.
class RigControl {
 public:
  RigControl(const bus::Parameters& parameters, std::uint64_t first_request_id)
      : options_(parameters), cameras_(first_request_id) {}

  /// Places the rigs. Returns the input and reference cameras that have left for good.
  std::vector<Camera> update(const ViewerPoses& poses, std::int64_t now_ns);
  /// Asks for the depth maps of the scene's lights, of which cascades lie about the viewers.
  void update_lights(const Light& light);
  /// From the next update() on references show who is where, too.
  void ask_for_ids() { wants_ids_ = true; }

  /// Asks for depth maps that have never come again.
  void reissue_missing_lights();
  /// Asks for a camera's picture again.
  void reissue(CameraRole role, std::uint32_t camera_id);

  [[nodiscard]] CameraSet& cameras() { return cameras_; }
  [[nodiscard]] InputRigs& inputs() { return inputs_; }
  [[nodiscard]] ReferenceRigs& references() { return references_; }
  [[nodiscard]] RangeFinder& ranges() { return ranges_; }
  [[nodiscard]] LightRig& lights() { return lights_; }

 private:
  [[nodiscard]] wire::EngineBuffer reference_buffers() const;

  bus::LiveOptions<Options> options_;
  CameraSet cameras_;
  Viewers viewers_;
  RangeFinder ranges_;
  InputRigs inputs_;
  ReferenceRigs references_;
  LightRig lights_;
  bool placed_ = false;
  bool wants_ids_ = false, asks_for_ids_ = false;  ///< of references
};

}  // namespace splatbus::capture_bridge
