#pragma once

#include <cstddef>
#include <opencv2/core/types.hpp>
#include <span>

struct GLFWmonitor;
struct GLFWwindow;

namespace splatbus::viewer {

/// Which of `monitors` has most of a window; the first where none has any of it. All of one desktop's pixels.
[[nodiscard]] std::size_t monitor_of(const cv::Rect& window, std::span<const cv::Rect> monitors);

/// A window that fills the monitor that it is on, and goes back to where it was.
class FullScreen {
 public:
  [[nodiscard]] static bool is(GLFWwindow* window);
  void toggle(GLFWwindow* window);

 private:
  cv::Rect before_;
};

}  // namespace splatbus::viewer
