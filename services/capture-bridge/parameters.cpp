#include "capture-bridge/parameters.h"

#include <fmt/format.h>

namespace splatbus::capture_bridge {

namespace {

constexpr int kMinSize = 8, kMaxReferenceSize = 4096, kMaxInputSize = 2048;  // pixels a side

bus::TextRule point_rule() {
  return {"a point x,y,z in metres", [](const std::string& text) {
            glm::vec3 point;
            return text.empty() || parse_point(text, point);
          }};
}

bus::TextRule size_rule(int maximum) {
  return {fmt::format("WxH or one number, {} to {} pixels", kMinSize, maximum), [maximum](const std::string& text) {
            PictureSize size;
            return parse_size(text, kMinSize, maximum, size);
          }};
}

}  // namespace

void Options::bind(bus::ParameterBinder& p) {
  using bus::kDegrees;
  using bus::kRuntime;
  p.add("fov_deg", ring.fov_radians, "vertical field of view of reference cameras, degrees", {10, 150}, kRuntime,
        kDegrees);
  p.add("input_fov_deg", input_fov_radians, "vertical field of view of input cameras, degrees; 0: that of fov_deg",
        {0, 150}, kRuntime, kDegrees);
  p.add("near_m", near_m, "nearest depth that cameras see, m", {.minimum = 1e-4});
  p.add("far_m", far_m, "farthest depth that cameras see, m", {.minimum = 0.1});
  p.add("input_cameras", dome.cameras, "cameras of the input dome", {0, 255});
  p.add("input_size", input_size, "size of input pictures in pixels, WxH or one number for a square",
        size_rule(kMaxInputSize));
  p.add("input_radius_m", dome.radius_m, "radius of the input dome, m", {.minimum = 0.05});
  p.add("input_focus_m", placement.focus_m, "distance in front of the viewer at which the input dome is centered, m",
        {.minimum = 0});
  p.add("input_lead_s", placement.lead_s, "time ahead of the viewer at which the input dome is placed, s", {0, 10});
  p.add("input_about", placement.about,
        "input cameras that look about from where a viewer will be, at most a quarter of all but one", {0, 64});
  p.add("input_center", input_center, "fixed center of the input dome, x,y,z in m; empty: the dome follows the viewers",
        point_rule());
  p.add("input_range_hz", range.rate_hz,
        "depth cubes per second, over all viewers, that find free places for input cameras; 0: none, and cameras may "
        "stand in walls",
        {0, 60});
  p.add("input_range_size", range.size, "width and height of each face of a depth cube, pixels", {8, 512});
  p.add("input_clearance_m", clearance_m, "least distance of input cameras from surfaces, m", {.minimum = 0});
  p.add("input_blind_m", blind_m,
        "depth below which a surface blocks an input camera; pictures half blocked are dropped; 0: keep all, m",
        {.minimum = 0});
  p.add("input_move_m", placement.move_m, "offset of its center beyond which the dome follows, m", {.minimum = 0});
  p.add("input_turn_deg", placement.turn_radians, "offset of its heading beyond which the dome follows, degrees",
        {0, 360}, kRuntime, kDegrees);
  p.add("input_rate_hz", input_rate_hz, "input pictures per second and camera; 0: one at each place of the dome",
        {0, 240});
  p.add("input_refresh_hz", input_refresh_hz,
        "input pictures per second, over all cameras, rendered again because the scene changed, oldest first; 0: none",
        {0, 1000});
  p.add("input_deadline_s", input_deadline_s,
        "time after which an incomplete round of input pictures is used, and in which a round is to come, s",
        {.minimum = 0.01});
  p.add("input_views", input_views, "publish input pictures as training views too");
  p.add("sample_budget", sampling.budget, "most samples in one input round; viewers share it as they share the cameras",
        {100, 4e6});
  p.add(
      "glance_share", glance_share,
      "share of sample_budget that the picture of a viewer's eye brings at once, and of his own share at least that a "
      "part of a dome brings; 0: it waits for its round",
      {0, 1});
  p.add("far_field", far_field,
        "sample the far field where input pictures show no surface but more than the background");
  p.add("min_cosine", sampling.min_cosine, "smallest cosine to the normal at which a sample is kept", {0.01, 1});
  p.add("cameras_per_surface", sampling.cameras_per_surface,
        "input cameras that keep their samples of one surface, best first; 0: as many as sample_budget allows",
        {0, 255});
  p.add("reference_rig", follow, "place of reference cameras: on a ring, or around the viewers once one is known",
        {{"ring", false}, {"follow", true}});
  p.add("reference_cameras", ring.cameras, "number of reference cameras", {0, 255});
  p.add("reference_size", reference_size, "size of reference pictures in pixels, WxH or one number for a square",
        size_rule(kMaxReferenceSize));
  p.add("reference_rate_hz", reference_rate_hz,
        "reference pictures per second of engine time; 0: one for each change of the rig or the scene", {0, 240});
  p.add("reference_refresh_hz", reference_refresh_hz,
        "reference pictures per second, over all cameras, rendered again because the scene changed, oldest first, when "
        "reference_rate_hz is 0; 0: none",
        {0, 1000});
  p.add("reference_depth", reference_depth,
        "ask the engine for depth with reference pictures, and with input pictures that are trained on");
  p.add("ring_radius_m", ring.radius_m, "radius of the reference ring, m", {.minimum = 0.01});
  p.add("ring_height_m", ring.height_m, "height of the reference ring above y = 0, m");
  p.add("ring_target", ring_target, "point that the ring's cameras look at, x,y,z in m", point_rule());
  p.add("ring_phase_deg", ring.phase_radians, "angle of the ring's first camera from +x towards +z, degrees", {},
        kRuntime, kDegrees);
  p.add("follow_picture", follow_rig.viewers_picture,
        "shape and field of view of the follow rig's pictures: fov_deg and reference_size, or the viewer's, widened, "
        "with as many pixels as reference_size",
        {{"own", false}, {"viewer", true}});
  p.add("follow_margin", follow_rig.margin, "factor by which the follow rig widens the viewer's picture", {1, 3});
  p.add("follow_side_m", follow_rig.side_m, "distance of the follow rig's side cameras, m");
  p.add("follow_above_m", follow_rig.above_m, "height of the follow rig's upper camera above the viewer, m");
  p.add("follow_toe_in_deg", follow_rig.toe_in_radians,
        "angle by which the follow rig's side and upper cameras turn towards the viewer's axis, degrees", {}, kRuntime,
        kDegrees);
  p.add("follow_move_m", follow_move_m, "smallest move that the follow rig follows, m", {.minimum = 0});
  p.add("follow_turn_deg", follow_turn_radians, "smallest turn that the follow rig follows, degrees", {.minimum = 0},
        kRuntime, kDegrees);
  p.add("light_depth_size", light.depth_size,
        "width and height of a depth map of the sun or a directional light, pixels", {16, 8192});
  p.add("light_source_size", light.source_size,
        "width and height of a spot light's depth map, and of each of a point light's six, pixels", {16, 4096});
  p.add("light_cascades", light.cascades,
        "most depth maps per sun or directional light: one of the whole scene, finer ones around the viewers",
        {1, kMaxLightMaps});
  p.add("light_extent_m", light.extent_m, "side of the finest cascade; each further one is four times as large, m",
        {.minimum = 0.1});
  p.add("probe_timeout_s", probe_timeout_s, "time after which an unanswered probe is dropped, s", {.minimum = 0.1});

  follow_rig.fov_radians = ring.fov_radians;
  dome.fov_radians = input_fov_radians > 0 ? input_fov_radians : ring.fov_radians;
  // Both are good by their rules.
  static_cast<void>(parse_size(reference_size, kMinSize, kMaxReferenceSize, ring.size));
  static_cast<void>(parse_size(input_size, kMinSize, kMaxInputSize, dome.size));
  follow_rig.cameras = ring.cameras;
  follow_rig.size = ring.size;
  range.move_m = 2 * placement.move_m;
  range.reach_m = dome.radius_m;
  placement.fixed_centre = !input_center.empty();
  if (!input_center.empty()) static_cast<void>(parse_point(input_center, placement.centre));
  if (!ring_target.empty()) static_cast<void>(parse_point(ring_target, ring.target));
}

RoundSizes Options::round_sizes() const {
  return {.views = static_cast<std::size_t>(dome.cameras), .pixels = dome.size.pixels(), .samples = sampling.budget};
}

}  // namespace splatbus::capture_bridge
