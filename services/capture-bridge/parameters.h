#pragma once

#include <string>

#include "bus/parameters.h"
#include "capture-bridge/light_rig.h"
#include "capture-bridge/range_finder.h"
#include "capture-bridge/rig.h"
#include "capture-bridge/sampler.h"

namespace splatbus::capture_bridge {

/// The capture-bridge's parameters.
struct Options {
  float near_m = 0.05F, far_m = 100;  ///< of input and reference cameras
  DomeOptions dome;
  std::string input_size = "128";
  float input_fov_radians = 0;  ///< 0: the reference cameras'
  DomePlacement placement;
  RangeOptions range;
  float clearance_m = 0.3F;  ///< from surfaces, of cameras that would stand in one
  float blind_m = 0.2F;      ///< a picture that shows mostly nearer surfaces is of no use
  std::string input_center;  ///< fixed centre of the dome; empty: it follows the viewer
  float input_rate_hz = 0;
  double glance_share = 0.25;   ///< of sampling.budget
  double input_refresh_hz = 8;  ///< pictures of all input cameras together, while the scene changes
  double input_deadline_s = 1.5;
  bool input_views = true;  ///< input pictures are training views too
  SamplingOptions sampling;

  bool follow = true;  ///< the reference cameras, once a viewer is known; or they stand on a ring
  RingOptions ring;
  std::string reference_size = "160";
  std::string ring_target = "0,0.25,0";
  FollowOptions follow_rig{.viewers_picture = true};
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
