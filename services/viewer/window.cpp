#include "viewer/window.h"

#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <fmt/format.h>

#include <cstdlib>
#include <exception>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "gaussians/player.h"
#include "metrics/image_io.h"
#include "viewer/full_screen.h"
#include "viewer/steering.h"
#include "viewer/ui/kept_picture.h"
#include "viewer/ui/panels.h"
#include "viewer/ui/saved_file.h"
#include "viewer/ui/texts.h"

namespace splatbus::viewer {

namespace {

// A picture that came so recently has the next one soon, and the panels with it.
constexpr std::int64_t kRestsNs = 30'000'000;

std::string glfw_reason() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text ? text : "unknown";
}

}  // namespace

struct Window::Impl {
  GLFWwindow* window = nullptr;
  GLuint texture = 0, framebuffer = 0;
  Steering steering;
  std::optional<Panels> panels;  // these two in the window's context
  std::optional<KeptPicture> kept;
  std::string folder;
  bool frame_all = false, picture_due = false;
  std::pair<int, int> shown_size{};
  bool damaged = false;  // by another window that was over it
  std::optional<std::string> save;
  std::int64_t swapped_ns = 0;
  FullScreen full_screen;

  explicit Impl(const Camera& camera) : steering(camera) {}

  [[nodiscard]] std::pair<int, int> size() const {
    int width = 0, height = 0;
    glfwGetFramebufferSize(window, &width, &height);
    return {width, height};
  }

  void key(int which) {
    if (which == GLFW_KEY_F) act(Action::FrameAll);
    if (which == GLFW_KEY_G) act(Action::Follow);
    if (which == GLFW_KEY_I) act(Action::Figures);
    if (which == GLFW_KEY_M) panels->toggle_menu();
    if (which == GLFW_KEY_P) act(Action::Snapshot);
    if (which == GLFW_KEY_V || which == GLFW_KEY_F11) act(Action::FullScreen);
    if (which != GLFW_KEY_ESCAPE || panels->close()) return;
    if (FullScreen::is(window)) return full_screen.toggle(window);
    glfwSetWindowShouldClose(window, GLFW_TRUE);
  }

  void act(Action action) {
    switch (action) {
      case Action::FrameAll:
        frame_all = true;
        break;
      case Action::FullScreen:
        full_screen.toggle(window);
        break;
      case Action::Snapshot:
        save_picture();
        break;
      case Action::Figures:
        panels->toggle_figures();
        break;
      case Action::Follow:
        if (!steering.following() && !panels->content.player) return panels->say(texts::kNoPlayer);
        steering.toggle_follow();
        if (steering.following()) panels->say(texts::kFollowing);
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
        panels->toggle_menu();
        break;
    }
  }

  void save_picture() {
    try {
      const cv::Mat picture = kept->read();
      if (picture.empty()) return panels->say(texts::kNoPicture);
      const std::string path = new_file(folder, ".png");
      metrics::write_png(path, picture);
      panels->say(path);
    } catch (const std::exception& error) {
      panels->say(error.what());
    }
  }

  /// Framebuffer 0 has the picture.
  void present(bool new_picture) {
    panels->content.following = steering.following();
    panels->content.full_screen = FullScreen::is(window);
    const Settings before = panels->content.settings;
    const std::vector<Action> actions = panels->draw(new_picture);
    picture_due = picture_due || !(panels->content.settings == before);
    glfwSwapBuffers(window);
    damaged = false;
    swapped_ns = bus::now_ns();
    for (const Action action : actions) act(action);
  }

  void redraw() {
    if (!damaged && (!panels->due() || bus::now_ns() - swapped_ns < kRestsNs)) return;
    const auto [width, height] = size();
    kept->restore(width, height);
    present(false);
  }

  static Impl* of(GLFWwindow* in) { return static_cast<Impl*>(glfwGetWindowUserPointer(in)); }
  void listen();
};

void Window::Impl::listen() {
  glfwSetWindowUserPointer(window, this);
  glfwSetCursorPosCallback(window, [](GLFWwindow* in, double x, double y) {
    of(in)->steering.pointer(x, y);
    of(in)->panels->touch();
  });
  glfwSetMouseButtonCallback(window, [](GLFWwindow* in, int, int action, int) {
    if (action == GLFW_PRESS) of(in)->steering.press(!of(in)->panels->wants_mouse());
    of(in)->panels->touch();
  });
  glfwSetScrollCallback(window, [](GLFWwindow* in, double, double notches) {
    if (!of(in)->panels->wants_mouse()) of(in)->steering.scroll(notches);
    of(in)->panels->touch();
  });
  glfwSetWindowRefreshCallback(window, [](GLFWwindow* in) { of(in)->damaged = true; });
  panels.emplace(window);
  glfwSetKeyCallback(window, [](GLFWwindow* in, int key, int scancode, int action, int mods) {
    of(in)->panels->key(key, scancode, action, mods);
    if (action == GLFW_PRESS) of(in)->key(key);
  });
}

Window::Window(const Camera& camera, const std::string& title, For what) : impl_(std::make_unique<Impl>(camera)) {
  if (!std::getenv("DISPLAY") && !std::getenv("WAYLAND_DISPLAY")) {
    throw bus::Error(
        "a window was asked for (window=true), but there is no display: neither DISPLAY nor WAYLAND_DISPLAY is set");
  }
  if (!glfwInit()) throw bus::Error(fmt::format("no window: {}", glfw_reason()));
  const bool splats = what == For::Splats;
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, splats ? 4 : 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, splats ? 5 : 3);
  glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
  glfwWindowHint(GLFW_CONTEXT_ROBUSTNESS, splats ? GLFW_LOSE_CONTEXT_ON_RESET : GLFW_NO_ROBUSTNESS);
  impl_->window = glfwCreateWindow(static_cast<int>(camera.width), static_cast<int>(camera.height), title.c_str(),
                                   nullptr, nullptr);
  if (!impl_->window) {
    const std::string reason = glfw_reason();
    glfwTerminate();
    throw bus::Error(fmt::format("no window with OpenGL {}: {}", splats ? "4.5" : "3.3", reason));
  }
  glfwMakeContextCurrent(impl_->window);
  glfwSwapInterval(splats ? 1 : 0);
  glGenTextures(1, &impl_->texture);
  glGenFramebuffers(1, &impl_->framebuffer);
  impl_->steering.attach(impl_->window);
  impl_->kept.emplace();
  impl_->listen();
}

Window::~Window() {
  impl_->kept.reset();
  impl_->panels.reset();
  glfwDestroyWindow(impl_->window);
  glfwTerminate();
}

void Window::poll_events() {
  glfwPollEvents();
  impl_->steering.advance(!impl_->panels->wants_keyboard());
  impl_->redraw();
}

void Window::wait_events(std::chrono::milliseconds most) {
  glfwWaitEventsTimeout(std::chrono::duration<double>(most).count());
  impl_->steering.rest();
}

bool Window::closed() const {
  return glfwWindowShouldClose(impl_->window) == GLFW_TRUE;
}

Camera Window::camera() const {
  const auto [width, height] = impl_->size();
  return impl_->steering.camera(width, height);
}

bool Window::take_frame_all() {
  return std::exchange(impl_->frame_all, false);
}

void Window::frame(const glm::vec3& centre_m, float radius_m) {
  impl_->steering.frame(centre_m, radius_m, camera());
}

void Window::follow(const SceneState& scene) {
  impl_->panels->content.player = scene.objects.contains(kPlayerId);
  impl_->steering.follow(scene);
}

void Window::show(const cv::Mat& picture) {
  const auto [width, height] = impl_->size();
  glBindTexture(GL_TEXTURE_2D, impl_->texture);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGB8, picture.cols, picture.rows, 0, GL_BGR, GL_UNSIGNED_BYTE, picture.data);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, impl_->framebuffer);
  glFramebufferTexture2D(GL_READ_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, impl_->texture, 0);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, 0);
  glBlitFramebuffer(0, 0, picture.cols, picture.rows, 0, height, width, 0, GL_COLOR_BUFFER_BIT, GL_LINEAR);
  swap();
}

void Window::swap() {
  const auto [width, height] = impl_->size();
  impl_->kept->keep(width, height);
  // GLFW knows a window's new size before OpenGL does: a first picture of it may lack what was outside of the old.
  if (std::exchange(impl_->shown_size, {width, height}) != std::pair(width, height)) impl_->picture_due = true;
  impl_->present(true);
}

const Settings& Window::settings() const {
  return impl_->panels->content.settings;
}

bool Window::take_picture_due() {
  return std::exchange(impl_->picture_due, false);
}

void Window::offer_stream(std::size_t max_gaussians, std::uint32_t max_kbps) {
  impl_->panels->content.streams = true;
  impl_->panels->content.settings.max_gaussians = max_gaussians;
  impl_->panels->content.settings.max_kbps = max_kbps;
}

std::optional<std::string> Window::take_save() {
  return std::exchange(impl_->save, std::nullopt);
}

void Window::save_in(const std::string& folder) {
  impl_->folder = folder;
}

void Window::set_figures(const Figures& figures) {
  impl_->panels->set_figures(figures);
}

bool Window::shows_figures() const {
  return impl_->panels->shows_figures();
}

void Window::say(const std::string& text) {
  impl_->panels->say(text);
}

void Window::keep_saying(const std::string& text) {
  impl_->panels->keep_saying(text);
}

}  // namespace splatbus::viewer
