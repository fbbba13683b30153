#pragma once

#include <chrono>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <string>

#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "viewer/ui/figures.h"
#include "viewer/ui/settings.h"

namespace splatbus::viewer {

/// A GLFW window with a camera that a person steers, as the page's. Left button: about the target; another one, or
/// Shift: along the picture. Wheel, + and -: nearer or farther. W A S D Q E: move, ahead to where one looks, with Shift
/// faster. Arrows: look about. F: all is framed. G: goes along with the engine's player. V or F11: full screen. P: the
/// picture is saved. I: figures, M: menu, where the build has Dear ImGui. Escape: closes the menu, leaves full screen,
/// or closes. Its OpenGL context is current on the thread that made it. Main thread only; one a process.
class Window {
 public:
  enum class For { Pictures, Splats };

  /// Opens with `camera`'s size and begins at its pose. `what`: Pictures come ready made, from OpenGL 3.3 on; Splats
  /// are drawn in its context, OpenGL 4.5, in step with the display; where the driver has none it is for Pictures, and
  /// says so. Throws bus::Error when there is no display, or no context at all.
  Window(const Camera& camera, const std::string& title, For what = For::Pictures);
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Whether it is for Splats.
  [[nodiscard]] bool takes_splats() const;
  /// Takes what the person did, and moves the camera on to now. Draws a picture that rests anew where figures
  /// and menu are others, or where another window was over it.
  ///
  /// This and swap() throw ContextLost, of gl/context.h.
  void poll_events();
  /// After ContextLost, once nothing is left of what was made in the context: a window in its place, with another
  /// context of the same kind, that shows a picture of a moment ago until the next. Throws bus::Error where there is
  /// none; `this` is of no use then.
  void reopen();
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

  /// As chosen in the menu; what Painter and who streams follow.
  [[nodiscard]] const Settings& settings() const;
  /// Whether a picture is due though what it shows stands: another was chosen since, or the last was the first of its
  /// size.
  [[nodiscard]] bool take_picture_due();
  /// The menu has budgets from now on, which begin as these, and offers to save the model.
  void offer_stream(std::size_t max_gaussians, std::uint32_t max_kbps);
  /// The end of the file's name, ".ply", once after the person asked for the model.
  [[nodiscard]] std::optional<std::string> take_save();
  /// Where pictures are saved; empty: in the current folder.
  void save_in(const std::string& folder);

  void set_figures(const Figures& figures);
  [[nodiscard]] bool shows_figures() const;
  /// A line, for a few seconds; as long as there is none.
  void say(const std::string& text);
  void keep_saying(const std::string& text);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::viewer
