#include "viewer/window.h"

#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "gaussians/player.h"
#include "viewer/rig.h"

namespace splatbus::viewer {

namespace {

constexpr float kRadiansAPixel = 0.006F;
constexpr float kZoomANotch = 0.9F;
constexpr float kZoomASecond = 2.5F;
constexpr float kTurnASecond = 1.2F;  // radians
constexpr float kLongestStep_s = 0.1F;

std::string glfw_reason() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text ? text : "unknown";
}

}  // namespace

struct Window::Impl {
  GLFWwindow* window = nullptr;
  GLuint texture = 0, framebuffer = 0;
  Rig rig;
  float vertical_fov;
  double x = 0, y = 0;
  std::int64_t moved_ns = bus::now_ns();
  bool frame_all = false;
  std::optional<RigPose> followed;  ///< where the player's camera was last
  std::array<int, 4> windowed{};    // x, y, width, height before it was full screen

  explicit Impl(const Camera& camera)
      : rig(RigPose::of(camera)), vertical_fov(2 * std::atan(static_cast<float>(camera.height) / (2 * camera.fy))) {}

  [[nodiscard]] bool button(int which) const { return glfwGetMouseButton(window, which) == GLFW_PRESS; }
  [[nodiscard]] bool held(int key) const { return glfwGetKey(window, key) == GLFW_PRESS; }
  [[nodiscard]] float axis(int more, int less) const {
    return static_cast<float>(held(more)) - static_cast<float>(held(less));
  }
  [[nodiscard]] bool shift() const { return held(GLFW_KEY_LEFT_SHIFT) || held(GLFW_KEY_RIGHT_SHIFT); }

  void pointer(double to_x, double to_y) {
    const auto dx = static_cast<float>(to_x - x), dy = static_cast<float>(to_y - y);
    x = to_x;
    y = to_y;
    const bool left = button(GLFW_MOUSE_BUTTON_LEFT);
    if (button(GLFW_MOUSE_BUTTON_RIGHT) || button(GLFW_MOUSE_BUTTON_MIDDLE) || (left && shift())) {
      int width = 0, height = 0;
      glfwGetWindowSize(window, &width, &height);
      rig.pan(dx, dy, static_cast<float>(std::max(height, 1)) / (2 * std::tan(vertical_fov / 2)));
    } else if (left) {
      rig.orbit(dx * kRadiansAPixel, dy * kRadiansAPixel);
    }
  }

  void key(int which) {
    if (which == GLFW_KEY_F) frame_all = true;
    if (which == GLFW_KEY_G) followed = followed ? std::nullopt : std::optional(rig.goal());
    if (which == GLFW_KEY_V || which == GLFW_KEY_F11) toggle_full_screen();
    if (which != GLFW_KEY_ESCAPE) return;
    if (glfwGetWindowMonitor(window)) {
      toggle_full_screen();
    } else {
      glfwSetWindowShouldClose(window, GLFW_TRUE);
    }
  }

  void toggle_full_screen() {
    auto& [left, top, width, height] = windowed;
    if (glfwGetWindowMonitor(window)) {
      glfwSetWindowMonitor(window, nullptr, left, top, width, height, GLFW_DONT_CARE);
      return;
    }
    GLFWmonitor* monitor = glfwGetPrimaryMonitor();
    const GLFWvidmode* mode = monitor ? glfwGetVideoMode(monitor) : nullptr;
    if (!mode) return;
    glfwGetWindowPos(window, &left, &top);
    glfwGetWindowSize(window, &width, &height);
    glfwSetWindowMonitor(window, monitor, 0, 0, mode->width, mode->height, mode->refreshRate);
  }

  void advance() {
    const std::int64_t now_ns = bus::now_ns();
    const float seconds = static_cast<float>(now_ns - std::exchange(moved_ns, now_ns)) / 1e9F;
    const float step_s = std::min(seconds, kLongestStep_s);
    const RigMotion motion{.right = axis(GLFW_KEY_D, GLFW_KEY_A),
                           .up = axis(GLFW_KEY_E, GLFW_KEY_Q),
                           .ahead = axis(GLFW_KEY_W, GLFW_KEY_S),
                           .fast = shift()};
    if (motion.right != 0 || motion.up != 0 || motion.ahead != 0) rig.fly(motion, step_s);
    const float turn = kTurnASecond * step_s;
    const float right = axis(GLFW_KEY_RIGHT, GLFW_KEY_LEFT), up = axis(GLFW_KEY_UP, GLFW_KEY_DOWN);
    if (right != 0 || up != 0) rig.look(right * turn, -up * turn);
    const float nearer = axis(GLFW_KEY_EQUAL, GLFW_KEY_MINUS) + axis(GLFW_KEY_KP_ADD, GLFW_KEY_KP_SUBTRACT);
    if (nearer != 0) rig.zoom(std::pow(kZoomASecond, -nearer * step_s));
    rig.advance(seconds);
  }
};

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
  glfwSetWindowUserPointer(impl_->window, impl_.get());
  glfwSetCursorPosCallback(impl_->window, [](GLFWwindow* window, double x, double y) {
    static_cast<Impl*>(glfwGetWindowUserPointer(window))->pointer(x, y);
  });
  glfwSetScrollCallback(impl_->window, [](GLFWwindow* window, double, double notches) {
    static_cast<Impl*>(glfwGetWindowUserPointer(window))->rig.zoom(std::pow(kZoomANotch, static_cast<float>(notches)));
  });
  glfwSetKeyCallback(impl_->window, [](GLFWwindow* window, int key, int, int action, int) {
    if (action == GLFW_PRESS) static_cast<Impl*>(glfwGetWindowUserPointer(window))->key(key);
  });
  glGenTextures(1, &impl_->texture);
  glGenFramebuffers(1, &impl_->framebuffer);
}

Window::~Window() {
  glfwDestroyWindow(impl_->window);
  glfwTerminate();
}

void Window::poll_events() {
  glfwPollEvents();
  impl_->advance();
}

void Window::wait_events(std::chrono::milliseconds most) {
  glfwWaitEventsTimeout(std::chrono::duration<double>(most).count());
  impl_->moved_ns = bus::now_ns();  // a key moves from when it was pressed
}

bool Window::closed() const {
  return glfwWindowShouldClose(impl_->window) == GLFW_TRUE;
}

Camera Window::camera() const {
  int width = 0, height = 0;
  glfwGetFramebufferSize(impl_->window, &width, &height);
  return impl_->rig.camera(static_cast<std::uint32_t>(std::max(width, 8)),
                           static_cast<std::uint32_t>(std::max(height, 8)), impl_->vertical_fov);
}

bool Window::take_frame_all() {
  return std::exchange(impl_->frame_all, false);
}

void Window::frame(const glm::vec3& centre_m, float radius_m) {
  const Camera now = camera();
  const auto least = static_cast<float>(std::min(now.width, now.height));
  impl_->rig.frame(centre_m, radius_m, 2 * std::atan(least / (2 * now.fy)));
}

void Window::follow(const SceneState& scene) {
  const auto player = scene.objects.find(kPlayerId);
  if (!impl_->followed || player == scene.objects.end()) return;
  if (!(impl_->rig.goal() == *impl_->followed)) {  // somebody steers
    impl_->followed.reset();
    return;
  }
  impl_->rig.jump(RigPose::of({.world_from_camera = player->second.rigid}));
  impl_->followed = impl_->rig.goal();
}

void Window::show(const cv::Mat& picture) {
  int width = 0, height = 0;
  glfwGetFramebufferSize(impl_->window, &width, &height);
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
  glfwSwapBuffers(impl_->window);
}

}  // namespace splatbus::viewer
