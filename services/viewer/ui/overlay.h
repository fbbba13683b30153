#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "viewer/ui/settings.h"

struct GLFWwindow;

namespace splatbus::viewer {

/// What a person asks for in the menu, beside what Settings have.
enum class Action { FrameAll, FullScreen, Snapshot, Figures, Follow, SavePly, SaveGlb, SaveSpz, Close };

/// What overlay and menu show.
struct OverlayContent {
  std::vector<std::pair<std::string, std::string>> figures;  ///< none: they are hidden
  std::string notice;                                        ///< one line; empty: none
  bool menu = false;
  // Of the menu:
  bool streams = false;  ///< there are budgets, and a model to save
  bool player = false, following = false, full_screen = false, figures_shown = false;
  Settings settings;  ///< changed as chosen
};

/// Figures and menu over a window's picture. Of the thread whose context is current.
class Overlay {
 public:
  virtual ~Overlay() = default;
  Overlay(const Overlay&) = delete;
  Overlay& operator=(const Overlay&) = delete;

  /// Into framebuffer 0. Returns what was asked for. Leaves OpenGL's state as it was, but for the framebuffer.
  virtual std::vector<Action> draw(OverlayContent& content) = 0;
  /// As GLFW's key callback has it.
  virtual void key(int key, int scancode, int action, int mods) = 0;
  /// Whether it has yet to be drawn for keys that came faster than pictures.
  [[nodiscard]] virtual bool has_keys() const = 0;
  /// Whether mouse and keys are meant for it.
  [[nodiscard]] virtual bool wants_mouse() const = 0;
  [[nodiscard]] virtual bool wants_keyboard() const = 0;
  /// Whether a list of choices is open, which Escape closes.
  [[nodiscard]] virtual bool chooses() const = 0;

 protected:
  Overlay() = default;
};

/// Through Dear ImGui, whose callbacks call those that the window has already; its key callback is the caller's to
/// call. In builds with SPLATBUS_HAVE_IMGUI only.
[[nodiscard]] std::unique_ptr<Overlay> make_overlay(GLFWwindow* window);

}  // namespace splatbus::viewer
