#pragma once

#include <epoxy/gl.h>
#define GLFW_INCLUDE_NONE
#include <GLFW/glfw3.h>

#include <cstdint>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <utility>

#include "viewer/full_screen.h"
#include "viewer/steering.h"
#include "viewer/ui/kept_picture.h"
#include "viewer/ui/panels.h"
#include "viewer/window.h"

namespace splatbus::viewer {

struct Window::Impl {
  std::string title;
  bool splats = false;
  GLFWwindow* window = nullptr;
  GLuint texture = 0, framebuffer = 0;
  Steering steering;
  Panels panels;  // what it draws with, and the next one, are of the window's context
  std::optional<KeptPicture> kept;
  cv::Mat still;  // as kept once was
  std::int64_t still_ns = 0, picture_ns = 0;
  std::string folder;
  bool frame_all = false, picture_due = false, snapshot_due = false;
  std::pair<int, int> shown_size{};
  bool damaged = false;  // by another window that was over it
  std::optional<std::string> save;
  std::int64_t swapped_ns = 0;
  FullScreen full_screen;

  Impl(const Camera& camera, std::string name, bool draws_splats);
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() { close(); }
  /// False where there is no such context.
  [[nodiscard]] bool open(int width, int height);
  [[nodiscard]] std::string no_window() const;
  void close();
  void reopen();

  [[nodiscard]] std::pair<int, int> size() const;
  void key(int which);
  void act(Action action);
  void save_picture();
  /// Framebuffer 0 has the picture.
  void present(bool new_picture);
  /// A picture that rests, where what is over it has changed.
  void redraw();
  void keep_still();
  static Impl* of(GLFWwindow* in) { return static_cast<Impl*>(glfwGetWindowUserPointer(in)); }
  void listen();
  /// Nothing is heard of that window any more.
  static void ignore(GLFWwindow* in);
};

}  // namespace splatbus::viewer
