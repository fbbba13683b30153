#pragma once

#include <memory>
#include <string>

namespace splatbus {

/// An OpenGL 4.5 core context without a window: the first hardware EGL device that gives one, else Mesa's surfaceless
/// platform. Current on the thread that made it, for as long as it lives. Throws std::runtime_error that lists what was
/// tried.
class GlContext {
 public:
  GlContext();
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
  std::unique_ptr<Impl> impl_;
  std::string description_;
  bool software_ = false;
};

}  // namespace splatbus
