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
  /// Fills the monitor that has most of `place`, where it goes back to.
  void fill(GLFWwindow* window, const cv::Rect& place);
  /// Where the window is when it does not fill a monitor, by the desktop's coordinates.
  [[nodiscard]] cv::Rect place(GLFWwindow* window) const;

 private:
  cv::Rect before_;
};

}  // namespace splatbus::viewer
