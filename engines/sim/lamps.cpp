#include "sim/lamps.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>

namespace splatbus::sim {
namespace {

constexpr float kGlass_m = 0.035F;
constexpr float kRange_m = 5;

/// A lamp's way about the vertical through the origin: `turns` whole rounds, and as many waves as it says, in a period.
struct Way {
  double period_s, first_turn;
  float radius_m, height_m;
  int turns, waves;
};

Way way_of(std::size_t lamp) {
  // The golden ratio's multiples share out what they are used for evenly, however many there are.
  const auto share = [&](double step) {
    return step * static_cast<double>(lamp) - std::floor(step * static_cast<double>(lamp));
  };
  return {.period_s = 16 + 8 * share(0.618034),
          .first_turn = share(0.381966),
          .radius_m = static_cast<float>(0.35 + 0.9 * share(0.754878)),
          .height_m = static_cast<float>(1.38 + 0.3 * share(0.569840)),
          .turns = lamp % 2 == 0 ? 1 : -1,
          .waves = 2 + static_cast<int>(lamp % 3)};
}

constexpr float kWave_m = 0.1F;

glm::vec3 place(const Way& way, double time_s) {
  const double phase = time_s / way.period_s - std::floor(time_s / way.period_s);
  const double full = 2 * glm::pi<double>();
  const double angle = full * (way.turns * phase + way.first_turn);
  const double wave = full * way.waves * phase;
  const double radius = way.radius_m + kWave_m * std::cos(wave);
  return {radius * std::cos(angle), way.height_m + kWave_m * std::sin(wave), radius * std::sin(angle)};
}

/// Irradiance at 1 m.
glm::vec3 intensity(std::size_t lamp) {
  constexpr std::array<glm::vec3, 4> kTints{{{1, 0.78F, 0.5F}, {0.55F, 0.75F, 1}, {1, 0.5F, 0.45F}, {0.6F, 1, 0.65F}}};
  // A few light the toys well; more of them are dimmer, so that all together do not blind.
  return kTints.at(lamp % kTints.size()) * (lamp < 3 ? 3.2F : 1.2F);
}

}  // namespace

void add_lamps(Scene& scene) {
  for (std::size_t lamp = 0; lamp < kLamps; ++lamp) {
    const Way way = way_of(lamp);
    const glm::vec3 shines = intensity(lamp);
    const auto id = static_cast<std::uint32_t>(lamp + 1);
    scene.lighting.sources.push_back({.id = id, .at = [way, shines](double time_s) {
                                        const glm::vec3 at = place(way, time_s);
                                        splatbus_light_source source{};
                                        source.kind = SPLATBUS_LIGHT_POINT;
                                        source.casts_shadow = 1;
                                        for (int c = 0; c < 3; ++c) source.position[c] = at[c];
                                        for (int c = 0; c < 3; ++c) source.intensity[c] = shines[c];
                                        source.range_m = kRange_m;
                                        return std::optional(source);
                                      }});
    scene.materials.push_back({.base_color = shines / std::max(shines.x, std::max(shines.y, shines.z))});
    Object& glass =
        scene.add(fmt::format("lamp {}", id), sphere(kGlass_m, 16), static_cast<int>(scene.materials.size()) - 1);
    glass.motion = [way](double time_s) { return Pose{.translation = place(way, time_s)}; };
    const float reach = way.radius_m + kWave_m;
    glass.motion_origins.add({-reach, way.height_m - kWave_m, -reach});
    glass.motion_origins.add({reach, way.height_m + kWave_m, reach});
    glass.light_id = id;
    glass.emissive = true;
    glass.casts_shadow = false;
  }
}

}  // namespace splatbus::sim
