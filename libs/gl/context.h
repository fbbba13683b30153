#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>

namespace splatbus {

/// The device was reset: nothing that was made in the context can be used, and only another context draws again.
class ContextLost : public std::runtime_error {
 public:
  ContextLost() : std::runtime_error("the OpenGL context was lost: the graphics device was reset") {}
};
/// Throws ContextLost where the current one, if its driver says so much, is lost.
void require_context();
/// Of a current context that was lost: returns once the device's reset is over, or after `most`.
void await_reset(std::chrono::milliseconds most);

/// An OpenGL 4.5 core context without a window: the first hardware EGL device that gives one, else Mesa's surfaceless
/// platform. Current on the thread that made it, for as long as it lives. Throws std::runtime_error that lists what was
/// tried.
/// `suits`, asked of one that is current: whether it is on the device that is wanted. The first of which it says so is
/// taken before any other; where it says so of none, the first as without it.
class GlContext {
 public:
  using Suits = std::function<bool(const GlContext&)>;
  explicit GlContext(const Suits& suits = {});
  ~GlContext();
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;

  void make_current() const;
  [[nodiscard]] bool is_software() const { return software_; }
  [[nodiscard]] const std::string& description() const {
    return description_;
  }  ///< "device: NVIDIA ..., OpenGL 4.5 ..."

 private:
  struct Impl;
  /// Why there is none on that display; empty: there is, and it is current.
  std::string begin(const std::string& name, void* display);
  void end();

  std::unique_ptr<Impl> impl_;
  std::string description_;
  bool software_ = false;
};

}  // namespace splatbus
