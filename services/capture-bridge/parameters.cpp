#include "capture-bridge/parameters.h"

#include <spdlog/spdlog.h>

namespace splatbus::capture_bridge {

namespace {

/// Text that is no point is reported, and `point` stands.
void read_point(const char* name, const std::string& text, glm::vec3& point) {
  if (!text.empty() && !parse_point(text, point)) {
    spdlog::error("parameter {}: '{}' is not a point; write x,y,z in metres", name, text);
  }
}

/// The same for sizes of pictures.
void read_size(const char* name, const std::string& text, int minimum, int maximum, PictureSize& size) {
  if (!parse_size(text, minimum, maximum, size)) {
    spdlog::error("parameter {}: '{}' is no size; write WxH or one number, {} to {} pixels", name, text, minimum,
                  maximum);
  }
}

}  // namespace

void Options::bind(bus::ParameterBinder& p) {
  using bus::kDegrees;
  using bus::kRuntime;
  p.add("fov_deg", ring.fov_radians, "vertical field of view of reference cameras, degrees", {10, 150}, kRuntime,
        kDegrees);
  p.add("input_fov_deg", input_fov_radians, "vertical field of view of input cameras, degrees; 0: fov_deg", {0, 150},
        kRuntime, kDegrees);
  p.add("near_m", near_m, "nearest depth that cameras see, metres", {.minimum = 1e-4});
  p.add("far_m", far_m, "farthest depth that cameras see, metres", {.minimum = 0.1});
  p.add("input_cameras", dome.cameras, "cameras of the input dome", {0, 255});
  p.add("input_size", input_size, "of input pictures, pixels: WxH, or one number for a square");
  p.add("input_radius_m", dome.radius_m, "radius of the input dome, metres", {.minimum = 0.05});
  p.add("input_focus_m", placement.focus_m,
        "distance in front of the viewer at which the input dome is centred, metres", {.minimum = 0});
  p.add("input_lead_s", placement.lead_s,
        "the input dome is placed for where the viewer will be after this time at its velocity, seconds", {0, 10});
  p.add("input_center", input_center,
        "fixed centre of the input dome, x,y,z in metres; empty: the input cameras follow the viewers");
  p.add("input_range_hz", range.rate_hz,
        "depth cubes a second, of all viewers together, that find where input cameras can see; 0: none, and input "
        "cameras may stand in walls",
        {0, 60});
  p.add("input_range_size", range.size, "width and height of each of a depth cube's six faces, pixels", {8, 512});
  p.add("input_clearance_m", clearance_m, "how far from a surface cameras stand that would stand in one, metres",
        {.minimum = 0});
  p.add("input_blind_m", blind_m,
        "input pictures half of which show nearer surfaces are dropped, and their cameras placed elsewhere, metres; 0: "
        "none",
        {.minimum = 0});
  p.add("input_move_m", placement.move_m, "the dome follows when its centre is off by more, metres", {.minimum = 0});
  p.add("input_turn_deg", placement.turn_radians, "the dome follows when its heading is off by more, degrees", {0, 360},
        kRuntime, kDegrees);
  p.add("input_rate_hz", input_rate_hz, "rate of input pictures, Hz; 0: once for each place of the dome", {0, 240});
  p.add("input_refresh_hz", input_refresh_hz,
        "input pictures a second, of all cameras together, that are rendered anew because the scene has changed since, "
        "the "
        "oldest first; 0: none",
        {0, 1000});
  p.add("input_deadline_s", input_deadline_s, "an incomplete round of input pictures goes on after this time, seconds",
        {.minimum = 0.01});
  p.add("input_views", input_views, "publish input pictures as training views too");
  p.add("sample_budget", sampling.budget, "most samples of one input round", {100, 4e6});
  p.add("far_field", far_field,
        "where input pictures show no surface, and something else than the background, they are samples of the far "
        "field");
  p.add("min_cosine", sampling.min_cosine, "samples seen at a smaller cosine to the normal are dropped", {0.01, 1});
  p.add("cameras_per_surface", sampling.cameras_per_surface,
        "how many input cameras keep their samples of the same surface, the best ones; 0: as many as sample_budget has "
        "room for",
        {0, 255});
  p.add("reference_rig", follow,
        "where reference cameras stand: about the viewers, and on a ring until one is known; or always on the ring",
        {{"ring", false}, {"follow", true}});
  p.add("reference_cameras", ring.cameras, "reference cameras", {0, 255});
  p.add("reference_size", reference_size, "of reference pictures, pixels: WxH, or one number for a square");
  p.add("reference_rate_hz", reference_rate_hz,
        "rate of reference pictures, Hz of engine time; 0: for each change of the rig, and as the scene changes",
        {0, 240});
  p.add("reference_refresh_hz", reference_refresh_hz,
        "reference pictures a second, of all cameras together, that are rendered anew because the scene has changed "
        "since, the oldest first, where reference_rate_hz is 0; 0: none",
        {0, 1000});
  p.add("reference_depth", reference_depth, "ask the engine for depth with reference pictures");
  p.add("ring_radius_m", ring.radius_m, "radius of the reference ring, metres", {.minimum = 0.01});
  p.add("ring_height_m", ring.height_m, "height of the reference ring above y = 0, metres");
  p.add("ring_target", ring_target, "where the ring looks, x,y,z in metres");
  p.add("ring_phase_deg", ring.phase_radians, "angle of the ring's first camera from +x towards +z, degrees", {},
        kRuntime, kDegrees);
  p.add("follow_picture", follow_rig.viewers_picture,
        "follow rig: whose shape and field of view pictures have; the viewer's, a little widened, have as many pixels "
        "as reference_size",
        {{"own", false}, {"viewer", true}});
  p.add("follow_margin", follow_rig.margin, "follow rig: by how much the viewer's picture is widened", {1, 3});
  p.add("follow_side_m", follow_rig.side_m, "follow rig: distance of the side cameras, metres");
  p.add("follow_above_m", follow_rig.above_m, "follow rig: height of the upper camera above the viewer, metres");
  p.add("follow_toe_in_deg", follow_rig.toe_in_radians,
        "follow rig: how far side and upper cameras turn towards the viewer's axis, degrees", {}, kRuntime, kDegrees);
  p.add("follow_move_m", follow_move_m, "follow rig: smallest move that is followed, metres", {.minimum = 0});
  p.add("follow_turn_deg", follow_turn_radians, "follow rig: smallest turn that is followed, degrees", {.minimum = 0},
        kRuntime, kDegrees);
  p.add("light_depth_size", light.depth_size,
        "width and height of a depth map of the sun or a directional light, pixels", {16, 8192});
  p.add("light_source_size", light.source_size,
        "width and height of a spot light's depth map, and of each of a point light's six, pixels", {16, 4096});
  p.add("light_cascades", light.cascades,
        "most depth maps of the sun or a directional light: the whole scene's, and finer ones about the viewers "
        "where the scene is large",
        {1, kMaxLightMaps});
  p.add("light_extent_m", light.extent_m, "side of the finest cascade, metres; each further one is four times as large",
        {.minimum = 0.1});
  p.add("probe_timeout_s", probe_timeout_s,
        "a probe that the engine does not answer is dropped after this time, seconds", {.minimum = 0.1});

  follow_rig.fov_radians = ring.fov_radians;
  dome.fov_radians = input_fov_radians > 0 ? input_fov_radians : ring.fov_radians;
  read_size("reference_size", reference_size, 8, 4096, ring.size);
  read_size("input_size", input_size, 8, 2048, dome.size);
  follow_rig.cameras = ring.cameras;
  follow_rig.size = ring.size;
  range.move_m = 2 * placement.move_m;
  range.reach_m = dome.radius_m;
  placement.fixed_centre = !input_center.empty();
  read_point("input_center", input_center, placement.centre);
  read_point("ring_target", ring_target, ring.target);
}

RoundSizes Options::round_sizes() const {
  return {.views = static_cast<std::size_t>(dome.cameras), .pixels = dome.size.pixels(), .samples = sampling.budget};
}

}  // namespace splatbus::capture_bridge
