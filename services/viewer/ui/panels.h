#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "viewer/ui/figures.h"
#include "viewer/ui/overlay.h"

struct GLFWwindow;

namespace splatbus::viewer {

/// What is over a window's picture, and when it has to be drawn: figures, a notice, the menu and what it has chosen. In
/// a build without Dear ImGui it is never drawn, and notices are in the log alone.
class Panels {
 public:
  /// Of this window from now on; before detach() it has to be the one that there is.
  void attach(GLFWwindow* window);
  /// What was made in the window's context is no more; what is shown and chosen stays.
  void detach() { overlay_.reset(); }

  [[nodiscard]] bool can_draw() const { return overlay_ != nullptr; }
  /// Over a picture that is new, or over the same one again.
  [[nodiscard]] std::vector<Action> draw(bool new_picture);
  /// Whether what it shows is another than when it was drawn.
  [[nodiscard]] bool due();
  /// Mouse or keys moved.
  void touch();

  /// As GLFW's callback has it.
  void key(int key, int scancode, int action, int mods);
  [[nodiscard]] bool wants_mouse() const { return overlay_ && overlay_->wants_mouse(); }
  [[nodiscard]] bool wants_keyboard() const { return overlay_ && overlay_->wants_keyboard(); }
  void toggle_menu();
  void toggle_figures();
  /// What Escape closes first; false where there is nothing.
  bool close();

  /// For a few seconds, and in the log.
  void say(const std::string& text);
  /// As long as nothing else is said; empty: nothing.
  void keep_saying(const std::string& text) { kept_notice_ = text; }
  void set_figures(const Figures& figures) { figures_ = figures; }
  [[nodiscard]] bool shows_figures() const { return overlay_ && shows_figures_; }

  /// Of the menu; settings as chosen.
  OverlayContent content;

 private:
  void renew();

  std::unique_ptr<Overlay> overlay_;
  Figures figures_;
  FrameRate frame_rate_;
  bool shows_figures_ = true;
  std::string passing_notice_, kept_notice_;
  std::int64_t notice_until_ns_ = 0, rows_ns_ = 0;
  std::vector<std::pair<std::string, std::string>> drawn_figures_;
  std::string drawn_notice_;
  int touched_ = 1;  ///< pictures that are still to be drawn for it
};

}  // namespace splatbus::viewer
