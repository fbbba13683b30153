#pragma once

#include <vector>

#include "viewer/ui/overlay.h"

namespace splatbus::viewer {

/// Of what is over the picture, from the window's edge, pixels.
inline constexpr float kPanelMargin = 10;

/// Where the menu was drawn, in the window's coordinates.
struct MenuPlace {
  float left = 0, top = 0, right = 0, bottom = 0;
  [[nodiscard]] bool contains(float x, float y) const { return x >= left && x < right && y >= top && y < bottom; }
};

/// Between ImGui's NewFrame() and Render(). Adds what is asked for to `actions`, and changes the content's settings.
MenuPlace draw_menu(OverlayContent& content, std::vector<Action>& actions);

}  // namespace splatbus::viewer
