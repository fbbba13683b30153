#pragma once

#include <memory>
#include <opencv2/core.hpp>
#include <string>

#include "gaussians/camera.h"

namespace splatbus::viewer {

/// A GLFW window that shows pictures and steers a camera about a point. Left button: turn. Right button: move. Wheel:
/// nearer or farther. W A S D Q E: move. Escape: close. Main thread only; one a process.
class Window {
 public:
  /// Opens with `camera`'s size and begins at its pose. Throws bus::Error when there is no display, or no OpenGL 3.3.
  Window(const Camera& camera, const std::string& title);
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  void poll_events();
  /// CV_8UC3 BGR, stretched to the window.
  void show(const cv::Mat& picture);
  [[nodiscard]] bool closed() const;
  /// As steered, with the window's size in pixels.
  [[nodiscard]] Camera camera() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::viewer
