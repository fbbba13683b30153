#include "viewer/camera_path.h"

#include <cmath>
#include <glm/gtc/constants.hpp>

namespace splatbus::viewer {

std::vector<bus::ParameterSpec> path_parameter_specs() {
  return {
      {.name = "width", .default_value = std::int64_t{256}, .description = "pixels", .minimum = 8, .maximum = 8192},
      {.name = "height", .default_value = std::int64_t{256}, .description = "pixels", .minimum = 8, .maximum = 8192},
      {.name = "fov_degrees",
       .default_value = 60.0,
       .description = "vertical field of view, degrees",
       .minimum = 5,
       .maximum = 150},
      {.name = "path",
       .default_value = std::string("orbit"),
       .description = "of the camera, when there is no window to steer it",
       .choices = {"orbit", "still"}},
      {.name = "radius_m",
       .default_value = 4.0,
       .description = "metres from the target, level",
       .minimum = 0.01,
       .maximum = 1e4},
      {.name = "height_m",
       .default_value = 2.0,
       .description = "metres above the world's zero",
       .minimum = -1e4,
       .maximum = 1e4},
      {.name = "period_s", .default_value = 30.0, .description = "seconds a turn", .minimum = 0.1, .maximum = 1e6},
      {.name = "phase_degrees",
       .default_value = 0.0,
       .description = "where the orbit begins, from +x towards +z",
       .minimum = -360,
       .maximum = 360},
      {.name = "target_x_m",
       .default_value = 0.0,
       .description = "metres, what the camera looks at",
       .minimum = -1e4,
       .maximum = 1e4},
      {.name = "target_y_m", .default_value = 0.4, .description = "metres", .minimum = -1e4, .maximum = 1e4},
      {.name = "target_z_m", .default_value = 0.0, .description = "metres", .minimum = -1e4, .maximum = 1e4},
  };
}

Camera path_camera(const bus::Parameters& parameters, double seconds) {
  const auto number = [&](const char* name) { return static_cast<float>(parameters.number(name)); };
  const double turns = parameters.text("path") == "orbit" ? seconds / parameters.number("period_s") : 0;
  const float angle =
      glm::radians(number("phase_degrees")) + glm::two_pi<float>() * static_cast<float>(std::fmod(turns, 1.0));
  const glm::vec3 target(number("target_x_m"), number("target_y_m"), number("target_z_m"));
  const float radius = number("radius_m");
  const glm::vec3 eye(target.x + radius * std::cos(angle), number("height_m"), target.z + radius * std::sin(angle));
  return look_at(eye, target, static_cast<std::uint32_t>(parameters.integer("width")),
                 static_cast<std::uint32_t>(parameters.integer("height")), glm::radians(number("fov_degrees")));
}

}  // namespace splatbus::viewer
