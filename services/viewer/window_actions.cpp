#include <fmt/format.h>

#include <exception>
#include <string>

#include "gl/context.h"
#include "metrics/image_io.h"
#include "viewer/ui/saved_file.h"
#include "viewer/ui/texts.h"
#include "viewer/window_impl.h"

namespace splatbus::viewer {

void Window::Impl::key(int which) {
  if (which == GLFW_KEY_F) act(Action::FrameAll);
  if (which == GLFW_KEY_G) act(Action::Follow);
  if (which == GLFW_KEY_I) act(Action::Figures);
  if (which == GLFW_KEY_M) panels.toggle_menu();
  if (which == GLFW_KEY_P) act(Action::Snapshot);
  if (which == GLFW_KEY_V || which == GLFW_KEY_F11) act(Action::FullScreen);
  if (which != GLFW_KEY_ESCAPE || panels.close()) return;
  if (FullScreen::is(window)) return full_screen.toggle(window);
  glfwSetWindowShouldClose(window, GLFW_TRUE);
}

void Window::Impl::act(Action action) {
  switch (action) {
    case Action::FrameAll:
      frame_all = true;
      break;
    case Action::FullScreen:
      full_screen.toggle(window);
      break;
    case Action::Snapshot:
      snapshot_due = true;
      break;
    case Action::Figures:
      panels.toggle_figures();
      break;
    case Action::Follow:
      if (!steering.following() && !panels.content.player) return panels.say(texts::kNoPlayer);
      steering.toggle_follow();
      if (steering.following()) panels.say(texts::kFollowing);
      break;
    case Action::SavePly:
      save = ".ply";
      break;
    case Action::SaveGlb:
      save = ".glb";
      break;
    case Action::SaveSpz:
      save = ".spz";
      break;
    case Action::Close:
      panels.toggle_menu();
      break;
  }
}

void Window::Impl::save_picture() {
  const cv::Mat picture = kept->read();
  require_context();
  snapshot_due = false;
  try {
    if (picture.empty()) return panels.say(texts::kNoPicture);
    const std::string path = new_file(folder, ".png");
    metrics::write_png(path, picture);
    panels.say(fmt::format(texts::kSaved, path));
  } catch (const std::exception& error) {
    panels.say(error.what());
  }
}

void Window::Impl::listen() {
  glfwSetWindowUserPointer(window, this);
  glfwSetCursorPosCallback(window, [](GLFWwindow* in, double x, double y) {
    of(in)->steering.pointer(x, y);
    of(in)->panels.touch();
  });
  glfwSetMouseButtonCallback(window, [](GLFWwindow* in, int, int action, int) {
    if (action == GLFW_PRESS) of(in)->steering.press(!of(in)->panels.wants_mouse());
    of(in)->panels.touch();
  });
  glfwSetScrollCallback(window, [](GLFWwindow* in, double, double notches) {
    if (!of(in)->panels.wants_mouse()) of(in)->steering.scroll(notches);
    of(in)->panels.touch();
  });
  glfwSetWindowRefreshCallback(window, [](GLFWwindow* in) { of(in)->damaged = true; });
  panels.attach(window);
  glfwSetKeyCallback(window, [](GLFWwindow* in, int key, int scancode, int action, int mods) {
    of(in)->panels.key(key, scancode, action, mods);
    if (action == GLFW_PRESS) of(in)->key(key);
  });
}

void Window::Impl::ignore(GLFWwindow* in) {
  glfwSetCursorPosCallback(in, nullptr);
  glfwSetMouseButtonCallback(in, nullptr);
  glfwSetScrollCallback(in, nullptr);
  glfwSetWindowRefreshCallback(in, nullptr);
  glfwSetKeyCallback(in, nullptr);
}

}  // namespace splatbus::viewer
