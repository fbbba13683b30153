#include "gl/context.h"

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <array>
#include <stdexcept>
#include <string_view>
#include <thread>
#include <vector>

namespace splatbus {
namespace {

constexpr EGLint kMaxDevices = 32;

bool listed(const char* extensions, std::string_view name) {
  return extensions != nullptr && fmt::format(" {} ", extensions).find(fmt::format(" {} ", name)) != std::string::npos;
}

/// Hardware devices, then the surfaceless platform; none of them initialised.
std::vector<std::pair<std::string, EGLDisplay>> candidate_displays() {
  std::vector<std::pair<std::string, EGLDisplay>> displays;
  const char* client = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
  if (listed(client, "EGL_EXT_platform_device") &&
      (listed(client, "EGL_EXT_device_enumeration") || listed(client, "EGL_EXT_device_base"))) {
    std::array<EGLDeviceEXT, kMaxDevices> devices{};
    EGLint count = 0;
    if (eglQueryDevicesEXT(kMaxDevices, devices.data(), &count) == EGL_TRUE) {
      for (EGLint i = 0; i < count; ++i) {
        EGLDeviceEXT device = devices.at(static_cast<std::size_t>(i));
        const bool software = listed(client, "EGL_EXT_device_query") &&
                              listed(eglQueryDeviceStringEXT(device, EGL_EXTENSIONS), "EGL_MESA_device_software");
        if (software) continue;
        displays.emplace_back(fmt::format("device {}", i),
                              eglGetPlatformDisplayEXT(EGL_PLATFORM_DEVICE_EXT, device, nullptr));
      }
    }
  }
  if (listed(client, "EGL_MESA_platform_surfaceless")) {
    displays.emplace_back("surfaceless",
                          eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr));
  }
  return displays;
}

void GLAPIENTRY log_gl_message(GLenum /*source*/, GLenum type, GLuint /*id*/, GLenum /*severity*/, GLsizei length,
                               const GLchar* text, const void* /*user*/) {
  if (type == GL_DEBUG_TYPE_ERROR)
    spdlog::error("OpenGL: {}", std::string_view(text, static_cast<std::size_t>(length)));
}

}  // namespace

namespace {

GLenum reset_status() {
  const bool tells = epoxy_gl_version() >= 45 || epoxy_has_gl_extension("GL_KHR_robustness");
  return tells ? glGetGraphicsResetStatus() : GL_NO_ERROR;
}

}  // namespace

void require_context() {
  if (reset_status() != GL_NO_ERROR) throw ContextLost();
}

void await_reset(std::chrono::milliseconds most) {
  // As long as it goes on, that is what is said (OpenGL 4.5, 2.3.2).
  constexpr std::chrono::milliseconds kPause{50};
  for (auto waited = kPause; reset_status() != GL_NO_ERROR && waited < most; waited += kPause) {
    std::this_thread::sleep_for(kPause);
  }
}

struct GlContext::Impl {
  EGLDisplay display = EGL_NO_DISPLAY;
  EGLContext context = EGL_NO_CONTEXT;
};

GlContext::GlContext(const Suits& suits) : impl_(std::make_unique<Impl>()) {
  const auto displays = candidate_displays();
  std::string tried;
  for (const auto& [name, display] : suits ? displays : decltype(displays){}) {
    if (!begin(name, display).empty()) continue;
    if (suits(*this)) return;
    end();
  }
  for (const auto& [name, display] : displays) {
    const std::string problem = begin(name, display);
    if (problem.empty()) return;
    tried += fmt::format(" {}: {};", name, problem);
  }
  throw std::runtime_error(fmt::format("no OpenGL 4.5 without a window:{}",
                                       tried.empty() ? " EGL offers no device or surfaceless platform" : tried));
}

std::string GlContext::begin(const std::string& name, void* display) {
  EGLint major = 0;
  EGLint minor = 0;
  if (display == EGL_NO_DISPLAY || eglInitialize(display, &major, &minor) != EGL_TRUE) {
    return fmt::format("cannot be initialised (EGL error {:#x})", eglGetError());
  }
  constexpr std::array<EGLint, 9> kAttributes{EGL_CONTEXT_MAJOR_VERSION,
                                              4,
                                              EGL_CONTEXT_MINOR_VERSION,
                                              5,
                                              EGL_CONTEXT_OPENGL_PROFILE_MASK,
                                              EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT,
                                              EGL_NONE,
                                              EGL_NONE,
                                              EGL_NONE};
  EGLContext context = EGL_NO_CONTEXT;
  if (eglBindAPI(EGL_OPENGL_API) == EGL_TRUE) {
    context = eglCreateContext(display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, kAttributes.data());
  }
  if (context == EGL_NO_CONTEXT || eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context) != EGL_TRUE) {
    const EGLint error = eglGetError();
    if (context != EGL_NO_CONTEXT) eglDestroyContext(display, context);
    return fmt::format("no OpenGL 4.5 core context (EGL error {:#x})", error);
  }
  impl_->display = display;
  impl_->context = context;
  const auto text = [](GLenum what) { return reinterpret_cast<const char*>(glGetString(what)); };
  description_ = fmt::format("{}: {}, OpenGL {}", name, text(GL_RENDERER), text(GL_VERSION));
  software_ = std::string_view(text(GL_RENDERER)).find("llvmpipe") != std::string_view::npos ||
              std::string_view(text(GL_RENDERER)).find("softpipe") != std::string_view::npos;
  glEnable(GL_DEBUG_OUTPUT);
  glDebugMessageCallback(log_gl_message, nullptr);
  return {};
}

void GlContext::end() {
  if (impl_->context == EGL_NO_CONTEXT) return;
  eglMakeCurrent(impl_->display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
  eglDestroyContext(impl_->display, impl_->context);
  impl_->context = EGL_NO_CONTEXT;
}

GlContext::~GlContext() {
  end();
}

void GlContext::make_current() const {
  if (eglMakeCurrent(impl_->display, EGL_NO_SURFACE, EGL_NO_SURFACE, impl_->context) != EGL_TRUE) {
    throw std::runtime_error(fmt::format("the OpenGL context cannot be made current (EGL error {:#x})", eglGetError()));
  }
}

}  // namespace splatbus
