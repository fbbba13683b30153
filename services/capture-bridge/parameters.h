#pragma once

#include <string>

#include "bus/parameters.h"
#include "capture-bridge/light_rig.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge {

/// The capture-bridge's parameters.
struct Options {
  float near_m = 0.05F, far_m = 100;  ///< of input and reference cameras
  DomeOptions dome;
  InputRigTracker::Options tracker;
  std::string input_center;  ///< fixed centre of the dome; empty: it follows the viewer
  float input_rate_hz = 0;
  double input_refresh_hz = 8;  ///< pictures of all input cameras together, while the scene changes
  double input_deadline_s = 1.5;
  bool input_views = true;  ///< input pictures are training views too
  SamplingOptions sampling;

  bool follow = false;  ///< the reference cameras, or they stand on a ring
  RingOptions ring;
  std::string ring_target = "0,0.25,0";
  FollowOptions follow_rig;
  float follow_move_m = 0.05F, follow_turn_radians = 0.034906585F;  ///< smallest that are followed
  float reference_rate_hz = 1;
  double reference_refresh_hz = 8;  ///< as input_refresh_hz, of reference cameras, where they have no rate
  bool reference_depth = true;
  bool far_field = true;
  LightRigOptions light;
  double probe_timeout_s = 10;

  void bind(bus::ParameterBinder& parameters);

  /// What is to be expected of a round.
  [[nodiscard]] RoundSizes round_sizes() const;
};

}  // namespace splatbus::capture_bridge
