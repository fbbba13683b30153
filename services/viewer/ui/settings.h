#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <optional>

#include "gaussians/light.h"

namespace splatbus::viewer {

/// What a person chose in the window's menu.
struct Settings {
  float resolution = 1;                 ///< of the splats, of the window's along each side
  std::optional<glm::vec3> background;  ///< linear; nullopt: the scene's
  std::size_t max_gaussians = 0;
  std::uint32_t max_kbps = 0;  ///< 0: as the streamer likes
  bool operator==(const Settings&) const = default;

  [[nodiscard]] SceneState applied_to(SceneState scene) const {
    if (background) scene.light.background = *background;
    return scene;
  }
};

// The page's (web/src/ui/settings.ts); of the texts' order.
inline constexpr std::array kResolutions{1.0F, 0.75F, 0.5F, 0.35F};
inline constexpr std::array kBackgroundGrays{0.0F, 0.2F, 1.0F};  ///< after the scene's
inline constexpr std::array<std::size_t, 5> kGaussianBudgets{100'000, 300'000, 1'000'000, 2'000'000, 4'000'000};
inline constexpr std::array<std::uint32_t, 7> kRateBudgets{0, 1'000, 2'000, 5'000, 10'000, 20'000, 50'000};  ///< kbit/s

}  // namespace splatbus::viewer
