#include "viewer/window.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <cstdlib>
#include <memory>
#include <utility>
#include <vector>

#include "bus/clock.h"
#include "bus/error.h"
#include "gaussians/player.h"
#include "gl/context.h"
#include "viewer/window_impl.h"

namespace splatbus::viewer {

namespace {

// A picture that came so recently has the next one soon, and the panels with it.
constexpr std::int64_t kRestsNs = 30'000'000;
// A picture is read back, for reopen(), once it has stood for the one, and while pictures come as seldom as the other.
constexpr std::int64_t kStandsNs = 300'000'000, kStillEveryNs = 5'000'000'000;

std::string glfw_reason() {
  const char* text = nullptr;
  glfwGetError(&text);
  return text ? text : "unknown";
}

const char* text_of(GLenum what) {
  const auto* const text = reinterpret_cast<const char*>(glGetString(what));
  return text ? text : "unknown";
}

}  // namespace

Window::Impl::Impl(const Camera& camera, std::string name, bool draws_splats)
    : title(std::move(name)), splats(draws_splats), steering(camera) {
  const auto width = static_cast<int>(camera.width), height = static_cast<int>(camera.height);
  if (open(width, height)) return;
  std::string reasons = no_window();
  if (splats) {
    splats = false;
    if (open(width, height)) {
      // Asked for 3.3, a driver gives the newest it has that is compatible.
      spdlog::warn(
          "no OpenGL 4.5, which is needed to draw in the window: {} offers OpenGL {}. A rasteriser makes the pictures "
          "instead, more slowly",
          text_of(GL_RENDERER), text_of(GL_VERSION));
      return;
    }
    reasons += "; " + no_window();
  }
  throw bus::Error(reasons +
                   "; a newer graphics driver helps, or Mesa's software device (LIBGL_ALWAYS_SOFTWARE=1); without a "
                   "window, --set out=FOLDER --set frames=1 writes pictures");
}

std::string Window::Impl::no_window() const {
  return fmt::format("no window with OpenGL {}: {}", splats ? "4.5" : "3.3", glfw_reason());
}

bool Window::Impl::open(int width, int height) {
  glfwWindowHint(GLFW_CONTEXT_VERSION_MAJOR, splats ? 4 : 3);
  glfwWindowHint(GLFW_CONTEXT_VERSION_MINOR, splats ? 5 : 3);
  glfwWindowHint(GLFW_OPENGL_PROFILE, GLFW_OPENGL_CORE_PROFILE);
  glfwWindowHint(GLFW_CONTEXT_ROBUSTNESS, GLFW_LOSE_CONTEXT_ON_RESET);
  window = glfwCreateWindow(width, height, title.c_str(), nullptr, nullptr);
  if (!window) return false;
  glfwMakeContextCurrent(window);
  glfwSwapInterval(splats ? 1 : 0);
  glGenTextures(1, &texture);
  glGenFramebuffers(1, &framebuffer);
  steering.attach(window);
  kept.emplace();
  listen();
  return true;
}

void Window::Impl::close() {
  kept.reset();
  panels.detach();
  if (window) glfwDestroyWindow(std::exchange(window, nullptr));
}

void Window::Impl::reopen() {
  const auto was = [this](int attribute) { return glfwGetWindowAttrib(window, attribute); };
  const bool full = FullScreen::is(window), iconified = was(GLFW_ICONIFIED) == GLFW_TRUE;
  const cv::Rect place = full_screen.place(window);
  glfwWindowHint(GLFW_FOCUSED, was(GLFW_FOCUSED));
  glfwWindowHint(GLFW_FOCUS_ON_SHOW, was(GLFW_FOCUSED));
  glfwWindowHint(GLFW_MAXIMIZED, was(GLFW_MAXIMIZED));
  kept.reset();
  panels.detach();
  // The old one goes when the new one shows something.
  glfwPollEvents();  // of the time in which nobody listened
  GLFWwindow* const old = std::exchange(window, nullptr);
  const std::unique_ptr<GLFWwindow, decltype(&glfwDestroyWindow)> goes(old, &glfwDestroyWindow);
  ignore(old);
  if (!open(place.width, place.height)) throw bus::Error(no_window());
  glfwSetWindowShouldClose(window, glfwWindowShouldClose(old));
  glfwSetWindowPos(window, place.x, place.y);
  if (full) full_screen.fill(window, place);
  if (iconified) glfwIconifyWindow(window);
  picture_due = true;
  if (still.empty()) return;
  const auto [width, height] = size();
  kept->put(still);
  kept->restore(width, height);
  present(false);
}

std::pair<int, int> Window::Impl::size() const {
  int width = 0, height = 0;
  glfwGetFramebufferSize(window, &width, &height);
  return {width, height};
}

void Window::Impl::present(bool new_picture) {
  panels.content.following = steering.following();
  panels.content.full_screen = FullScreen::is(window);
  const Settings before = panels.content.settings;
  const std::vector<Action> actions = panels.draw(new_picture);
  picture_due = picture_due || !(panels.content.settings == before);
  glfwSwapBuffers(window);
  damaged = false;
  swapped_ns = bus::now_ns();
  for (const Action action : actions) act(action);
}

void Window::Impl::redraw() {
  if (!damaged && (!panels.due() || bus::now_ns() - swapped_ns < kRestsNs)) return;
  const auto [width, height] = size();
  kept->restore(width, height);
  present(false);
}

void Window::Impl::keep_still() {
  if (picture_ns <= still_ns) return;
  const std::int64_t now_ns = bus::now_ns();
  if (now_ns - picture_ns < kStandsNs && now_ns - still_ns < kStillEveryNs) return;
  cv::Mat now = kept->read();
  require_context();  // what is read of one that is lost is nothing
  still = std::move(now);
  still_ns = now_ns;
}

Window::Window(const Camera& camera, const std::string& title, For what) {
  if (!std::getenv("DISPLAY") && !std::getenv("WAYLAND_DISPLAY")) {
    throw bus::Error(
        "a window was asked for (window=true), but there is no display: neither DISPLAY nor WAYLAND_DISPLAY is set");
  }
  if (!glfwInit()) throw bus::Error(fmt::format("no window: {}", glfw_reason()));
  try {
    impl_ = std::make_unique<Impl>(camera, title, what == For::Splats);
  } catch (...) {
    glfwTerminate();
    throw;
  }
}

Window::~Window() {
  impl_.reset();
  glfwTerminate();
}

bool Window::takes_splats() const {
  return impl_->splats;
}

void Window::reopen() {
  impl_->reopen();
}

void Window::poll_events() {
  glfwPollEvents();
  require_context();
  impl_->steering.advance(!impl_->panels.wants_keyboard());
  impl_->keep_still();
  if (impl_->snapshot_due) impl_->save_picture();
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
  impl_->panels.content.player = scene.objects.contains(kPlayerId);
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
  require_context();
  impl_->kept->keep(width, height);
  impl_->picture_ns = bus::now_ns();
  // GLFW knows a window's new size before OpenGL does: a first picture of it may lack what was outside of the old.
  if (std::exchange(impl_->shown_size, {width, height}) != std::pair(width, height)) impl_->picture_due = true;
  impl_->present(true);
}

const Settings& Window::settings() const {
  return impl_->panels.content.settings;
}

bool Window::take_picture_due() {
  return std::exchange(impl_->picture_due, false);
}

void Window::offer_stream(std::size_t max_gaussians, std::uint32_t max_kbps) {
  impl_->panels.content.streams = true;
  impl_->panels.content.settings.max_gaussians = max_gaussians;
  impl_->panels.content.settings.max_kbps = max_kbps;
}

std::optional<std::string> Window::take_save() {
  return std::exchange(impl_->save, std::nullopt);
}

void Window::save_in(const std::string& folder) {
  impl_->folder = folder;
}

void Window::set_figures(const Figures& figures) {
  impl_->panels.set_figures(figures);
}

bool Window::shows_figures() const {
  return impl_->panels.shows_figures();
}

void Window::say(const std::string& text) {
  impl_->panels.say(text);
}

void Window::keep_saying(const std::string& text) {
  impl_->panels.keep_saying(text);
}

}  // namespace splatbus::viewer
