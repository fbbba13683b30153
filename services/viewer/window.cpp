#include "viewer/window.h"

#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <glm/gtc/constants.hpp>

#include "bus/clock.h"
#include "bus/error.h"

namespace splatbus::viewer {

namespace {

constexpr float kRadiansAPixel = 0.006F;
constexpr float kZoomANotch = 0.9F;
constexpr float kSpeed = 0.8F;  // distances to the target a second

std::string glfw_reason() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text ? text : "unknown";
}

}  // namespace

struct Window::Impl {
  GLFWwindow* window = nullptr;
  GLuint texture = 0, framebuffer = 0;
  glm::vec3 target{0};
  float yaw = 0, pitch = 0.3F, distance = 3, vertical_fov = 1;
  double x = 0, y = 0;
  std::int64_t moved_ns = bus::now_ns();

  [[nodiscard]] glm::vec3 backward() const {
    return {std::cos(pitch) * std::cos(yaw), std::sin(pitch), std::cos(pitch) * std::sin(yaw)};
  }
  [[nodiscard]] glm::vec3 right() const { return glm::normalize(glm::cross(-backward(), glm::vec3(0, 1, 0))); }

  void begin_at(const Camera& camera) {
    const glm::vec3 eye = camera.world_from_camera.translation;
    const glm::vec3 forward = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
    // Where the view meets the floor, or a few metres ahead.
    distance = forward.y < -0.05F && eye.y > 0.1F ? std::min(-eye.y / forward.y, 20.0F) : 3.0F;
    target = eye + forward * distance;
    pitch = std::asin(std::clamp(-forward.y, -1.0F, 1.0F));
    yaw = std::atan2(-forward.z, -forward.x);
    vertical_fov = 2 * std::atan(static_cast<float>(camera.height) / (2 * camera.fy));
  }

  void pointer(double to_x, double to_y) {
    const auto dx = static_cast<float>(to_x - x), dy = static_cast<float>(to_y - y);
    x = to_x;
    y = to_y;
    if (glfwGetMouseButton(window, GLFW_MOUSE_BUTTON_LEFT) == GLFW_PRESS) {
      yaw += dx * kRadiansAPixel;
      pitch = std::clamp(pitch + dy * kRadiansAPixel, -1.5F, 1.5F);
    } else if (glfwGetMouseButton(window, GLFW_MOUSE_BUTTON_RIGHT) == GLFW_PRESS) {
      const glm::vec3 up = glm::cross(right(), -backward());
      target += (up * dy - right() * dx) * (0.002F * distance);
    }
  }

  void keys() {
    const std::int64_t now_ns = bus::now_ns();
    const float step =
        kSpeed * distance * static_cast<float>(std::min<std::int64_t>(now_ns - moved_ns, 100'000'000)) / 1e9F;
    moved_ns = now_ns;
    const auto axis = [&](int more, int less) {
      return static_cast<float>((glfwGetKey(window, more) == GLFW_PRESS) - (glfwGetKey(window, less) == GLFW_PRESS));
    };
    glm::vec3 ahead = -backward();
    ahead.y = 0;
    if (glm::length(ahead) > 1e-4F) ahead = glm::normalize(ahead);
    target += step * (ahead * axis(GLFW_KEY_W, GLFW_KEY_S) + right() * axis(GLFW_KEY_D, GLFW_KEY_A) +
                      glm::vec3(0, 1, 0) * axis(GLFW_KEY_E, GLFW_KEY_Q));
    if (glfwGetKey(window, GLFW_KEY_ESCAPE) == GLFW_PRESS) glfwSetWindowShouldClose(window, GLFW_TRUE);
  }
};

Window::Window(const Camera& camera, const std::string& title) : impl_(std::make_unique<Impl>()) {
  if (!std::getenv("DISPLAY") && !std::getenv("WAYLAND_DISPLAY")) {
    throw bus::Error(
        "a window was asked for (window=true), but there is no display: neither DISPLAY nor WAYLAND_DISPLAY is set");
  }
  if (!glfwInit()) throw bus::Error(fmt::format("no window: {}", glfw_reason()));
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, 3);
  glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
  impl_->window = glfwCreateWindow(static_cast<int>(camera.width), static_cast<int>(camera.height), title.c_str(),
                                   nullptr, nullptr);
  if (!impl_->window) {
    const std::string reason = glfw_reason();
    glfwTerminate();
    throw bus::Error(fmt::format("no window: {}", reason));
  }
  glfwMakeContextCurrent(impl_->window);
  glfwSwapInterval(0);
  impl_->begin_at(camera);
  glfwSetWindowUserPointer(impl_->window, impl_.get());
  glfwSetCursorPosCallback(impl_->window, [](GLFWwindow* window, double x, double y) {
    static_cast<Impl*>(glfwGetWindowUserPointer(window))->pointer(x, y);
  });
  glfwSetScrollCallback(impl_->window, [](GLFWwindow* window, double, double notches) {
    auto& self = *static_cast<Impl*>(glfwGetWindowUserPointer(window));
    self.distance = std::clamp(self.distance * std::pow(kZoomANotch, static_cast<float>(notches)), 0.05F, 1e4F);
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
  impl_->keys();
}

bool Window::closed() const {
  return glfwWindowShouldClose(impl_->window) == GLFW_TRUE;
}

Camera Window::camera() const {
  int width = 0, height = 0;
  glfwGetFramebufferSize(impl_->window, &width, &height);
  return look_at(impl_->target + impl_->backward() * impl_->distance, impl_->target,
                 static_cast<std::uint32_t>(std::max(width, 8)), static_cast<std::uint32_t>(std::max(height, 8)),
                 impl_->vertical_fov);
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
  glfwSwapBuffers(impl_->window);
}

}  // namespace splatbus::viewer
