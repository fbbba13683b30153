#pragma once

#include <chrono>
#include <memory>
#include <opencv2/core.hpp>
#include <string>

#include "gaussians/camera.h"
#include "gaussians/light.h"

namespace splatbus::viewer {

/// A GLFW window with a camera that a person steers, as the page's. Left button: about the target; another one, or
/// Shift: along the picture. Wheel, + and -: nearer or farther. W A S D Q E: move, with Shift faster. Arrows: look
/// about. F: all is framed. G: goes along with the engine's player. V or F11: full screen. Escape: leaves that, or
/// closes. Its OpenGL context is current on the thread that made it. Main thread only; one a process.
class Window {
 public:
  enum class For { Pictures, Splats };

  /// Opens with `camera`'s size and begins at its pose. `what`: Pictures come ready made, from OpenGL 3.3 on; Splats
  /// are drawn in its context, OpenGL 4.5, in step with the display. Throws bus::Error when there is no display, or no
  /// such context.
  Window(const Camera& camera, const std::string& title, For what = For::Pictures);
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Takes what the person did, and moves the camera on to now.
  void poll_events();
  /// Waits for something that the person does, at most so long; for a camera that rests.
  void wait_events(std::chrono::milliseconds most);
  /// CV_8UC3 BGR, stretched to the window.
  void show(const cv::Mat& picture);
  /// What was drawn into framebuffer 0, which has the camera's size, is shown; with Splats at the display's next frame.
  void swap();
  [[nodiscard]] bool closed() const;
  /// As steered, with the window's size in pixels.
  [[nodiscard]] Camera camera() const;
  /// Whether the person asked for it since: frame() does it.
  [[nodiscard]] bool take_frame_all();
  void frame(const glm::vec3& centre_m, float radius_m);
  /// Goes where the camera of the scene's player is, once the person has asked for it and until they steer again.
  void follow(const SceneState& scene);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::viewer
