#include "viewer/full_screen.h"

#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <algorithm>
#include <vector>

namespace splatbus::viewer {
namespace {

cv::Rect place_of(GLFWmonitor* monitor) {
  cv::Rect place;
  glfwGetMonitorPos(monitor, &place.x, &place.y);
  if (const GLFWvidmode* mode = glfwGetVideoMode(monitor)) place += cv::Size(mode->width, mode->height);
  return place;
}

cv::Rect place_of(GLFWwindow* window) {
  cv::Rect place;
  glfwGetWindowPos(window, &place.x, &place.y);
  glfwGetWindowSize(window, &place.width, &place.height);
  return place;
}

}  // namespace

std::size_t monitor_of(const cv::Rect& window, std::span<const cv::Rect> monitors) {
  const auto shared = [&](const cv::Rect& monitor) { return (monitor & window).area(); };
  return static_cast<std::size_t>(std::ranges::max_element(monitors, {}, shared) - monitors.begin());
}

bool FullScreen::is(GLFWwindow* window) {
  return glfwGetWindowMonitor(window) != nullptr;
}

cv::Rect FullScreen::place(GLFWwindow* window) const {
  return is(window) ? before_ : place_of(window);
}

void FullScreen::toggle(GLFWwindow* window) {
  if (is(window)) {
    glfwSetWindowMonitor(window, nullptr, before_.x, before_.y, before_.width, before_.height, GLFW_DONT_CARE);
    return;
  }
  fill(window, place_of(window));
}

void FullScreen::fill(GLFWwindow* window, const cv::Rect& place) {
  int count = 0;
  GLFWmonitor** const first = glfwGetMonitors(&count);
  const std::vector<GLFWmonitor*> monitors(first, first + count);
  if (monitors.empty()) return;
  std::vector<cv::Rect> places;
  for (GLFWmonitor* monitor : monitors) places.push_back(place_of(monitor));
  before_ = place;
  GLFWmonitor* const monitor = monitors[monitor_of(before_, places)];
  if (const GLFWvidmode* mode = glfwGetVideoMode(monitor)) {
    glfwSetWindowMonitor(window, monitor, 0, 0, mode->width, mode->height, mode->refreshRate);
  }
}

}  // namespace splatbus::viewer
