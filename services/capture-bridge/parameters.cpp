#include "capture-bridge/parameters.h"

#include <spdlog/spdlog.h>

#include <glm/trigonometric.hpp>

namespace splatbus::capture_bridge {

namespace {

float metres(const bus::Parameters& parameters, const char* name) {
  return static_cast<float>(parameters.number(name));
}

float radians(const bus::Parameters& parameters, const char* name) {
  return glm::radians(static_cast<float>(parameters.number(name)));
}

int integer(const bus::Parameters& parameters, const char* name) {
  return static_cast<int>(parameters.integer(name));
}

/// A point parameter; text that is none is reported and `fallback` stands.
glm::vec3 point(const bus::Parameters& parameters, const char* name, const glm::vec3& fallback) {
  glm::vec3 value = fallback;
  const std::string text = parameters.text(name);
  if (!text.empty() && !parse_point(text, value)) {
    spdlog::error("parameter {}: '{}' is not a point; write x,y,z in metres", name, text);
  }
  return value;
}

}  // namespace

std::vector<bus::ParameterSpec> parameter_specs() {
  using Specs = std::vector<bus::ParameterSpec>;
  Specs specs{
      {.name = "fov_deg",
       .default_value = 60.0,
       .description = "field of view of input and reference cameras, degrees",
       .minimum = 10,
       .maximum = 150},
      {.name = "near_m",
       .default_value = 0.05,
       .description = "nearest depth that cameras see, metres",
       .minimum = 1e-4},
      {.name = "far_m",
       .default_value = 100.0,
       .description = "farthest depth that cameras see, metres",
       .minimum = 0.1},
      {.name = "input_cameras",
       .default_value = std::int64_t{24},
       .description = "cameras of the input dome",
       .minimum = 0,
       .maximum = 255},
      {.name = "input_size",
       .default_value = std::int64_t{128},
       .description = "width and height of input pictures, pixels",
       .minimum = 8,
       .maximum = 2048},
      {.name = "input_radius_m",
       .default_value = 3.4,
       .description = "radius of the input dome, metres",
       .minimum = 0.05},
      {.name = "input_focus_m",
       .default_value = 3.4,
       .description = "distance in front of the viewer at which the input dome is centred, metres",
       .minimum = 0},
      {.name = "input_center",
       .default_value = std::string{},
       .description = "fixed centre of the input dome, x,y,z in metres; empty: the dome follows the viewer"},
      {.name = "input_move_m",
       .default_value = 0.5,
       .description = "the dome follows when its centre is off by more, metres",
       .minimum = 0},
      {.name = "input_turn_deg",
       .default_value = 60.0,
       .description = "the dome follows when its heading is off by more, degrees",
       .minimum = 0,
       .maximum = 360},
      {.name = "input_rate_hz",
       .default_value = 0.0,
       .description = "rate of input pictures, Hz; 0: once for each place of the dome",
       .minimum = 0,
       .maximum = 240},
      {.name = "input_deadline_s",
       .default_value = 1.5,
       .description = "an incomplete round of input pictures goes on after this time, seconds",
       .minimum = 0.01},
      {.name = "input_views", .default_value = true, .description = "publish input pictures as training views too"},
      {.name = "sample_budget",
       .default_value = std::int64_t{60000},
       .description = "most samples of one input round",
       .minimum = 100,
       .maximum = 4e6},
      {.name = "min_cosine",
       .default_value = 0.1,
       .description = "samples seen at a smaller cosine to the normal are dropped",
       .minimum = 0.01,
       .maximum = 1},
      {.name = "cameras_per_surface",
       .default_value = std::int64_t{0},
       .description = "how many input cameras keep their samples of the same surface, the best ones; 0: as many as "
                      "sample_budget has room for",
       .minimum = 0,
       .maximum = 255},
  };
  const Specs references{
      {.name = "reference_rig",
       .default_value = std::string("ring"),
       .description = "where reference cameras stand",
       .choices = {"ring", "follow"}},
      {.name = "reference_cameras",
       .default_value = std::int64_t{8},
       .description = "reference cameras",
       .minimum = 0,
       .maximum = 255},
      {.name = "reference_size",
       .default_value = std::int64_t{160},
       .description = "width and height of reference pictures, pixels",
       .minimum = 8,
       .maximum = 4096},
      {.name = "reference_rate_hz",
       .default_value = 1.0,
       .description = "rate of reference pictures, Hz of engine time; 0: once for each change of the rig",
       .minimum = 0,
       .maximum = 240},
      {.name = "reference_depth",
       .default_value = false,
       .description = "ask the engine for depth with reference pictures"},
      {.name = "ring_radius_m",
       .default_value = 3.4,
       .description = "radius of the reference ring, metres",
       .minimum = 0.01},
      {.name = "ring_height_m",
       .default_value = 1.6,
       .description = "height of the reference ring above y = 0, metres"},
      {.name = "ring_target",
       .default_value = std::string("0,0.25,0"),
       .description = "where the ring looks, x,y,z in metres"},
      {.name = "ring_phase_deg",
       .default_value = 0.0,
       .description = "angle of the ring's first camera from +x towards +z, degrees"},
      {.name = "follow_side_m",
       .default_value = 0.6,
       .description = "follow rig: distance of the side cameras, metres"},
      {.name = "follow_above_m",
       .default_value = 0.6,
       .description = "follow rig: height of the upper camera above the viewer, metres"},
      {.name = "follow_toe_in_deg",
       .default_value = 7.0,
       .description = "follow rig: how far side and upper cameras turn towards the viewer's axis, degrees"},
      {.name = "follow_move_m",
       .default_value = 0.05,
       .description = "follow rig: smallest move that is followed, metres",
       .minimum = 0},
      {.name = "follow_turn_deg",
       .default_value = 2.0,
       .description = "follow rig: smallest turn that is followed, degrees",
       .minimum = 0},
      {.name = "light_depth_size",
       .default_value = std::int64_t{1024},
       .description = "width and height of the sun's depth map, pixels",
       .minimum = 16,
       .maximum = 8192},
      {.name = "probe_timeout_s",
       .default_value = 10.0,
       .description = "a probe that the engine does not answer is dropped after this time, seconds",
       .minimum = 0.1},
  };
  specs.insert(specs.end(), references.begin(), references.end());
  return specs;
}

DomeOptions dome_options(const bus::Parameters& parameters) {
  return {.cameras = integer(parameters, "input_cameras"),
          .size = integer(parameters, "input_size"),
          .fov_radians = radians(parameters, "fov_deg"),
          .radius_m = metres(parameters, "input_radius_m")};
}

InputRigTracker::Options tracker_options(const bus::Parameters& parameters) {
  InputRigTracker::Options options{.focus_m = metres(parameters, "input_focus_m"),
                                   .move_m = metres(parameters, "input_move_m"),
                                   .turn_radians = radians(parameters, "input_turn_deg")};
  options.fixed_centre = !parameters.text("input_center").empty();
  options.centre = point(parameters, "input_center", options.centre);
  return options;
}

RingOptions ring_options(const bus::Parameters& parameters) {
  RingOptions options{.cameras = integer(parameters, "reference_cameras"),
                      .size = integer(parameters, "reference_size"),
                      .fov_radians = radians(parameters, "fov_deg"),
                      .radius_m = metres(parameters, "ring_radius_m"),
                      .height_m = metres(parameters, "ring_height_m"),
                      .phase_radians = radians(parameters, "ring_phase_deg")};
  options.target = point(parameters, "ring_target", options.target);
  return options;
}

FollowOptions follow_options(const bus::Parameters& parameters) {
  return {.cameras = integer(parameters, "reference_cameras"),
          .size = integer(parameters, "reference_size"),
          .fov_radians = radians(parameters, "fov_deg"),
          .side_m = metres(parameters, "follow_side_m"),
          .above_m = metres(parameters, "follow_above_m"),
          .toe_in_radians = radians(parameters, "follow_toe_in_deg")};
}

SamplingOptions sampling_options(const bus::Parameters& parameters) {
  SamplingOptions options;
  options.surface.min_cosine = static_cast<float>(parameters.number("min_cosine"));
  options.cameras_per_surface = integer(parameters, "cameras_per_surface");
  options.budget = static_cast<std::size_t>(parameters.integer("sample_budget"));
  return options;
}

RoundSizes round_sizes(const bus::Parameters& parameters) {
  const auto size = static_cast<std::size_t>(parameters.integer("input_size"));
  return {.views = static_cast<std::size_t>(parameters.integer("input_cameras")),
          .pixels = size * size,
          .samples = static_cast<std::size_t>(parameters.integer("sample_budget"))};
}

}  // namespace splatbus::capture_bridge
