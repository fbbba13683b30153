#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "bus/parameters.h"
#include "stream/layout.h"
#include "viewer/camera_path.h"
#include "viewer/gl/draw_choice.h"

namespace splatbus::viewer {

/// The viewer's parameters.
struct Options {
  std::string endpoint;
  std::string key, server_key, token, ca;
  double fps = 30;
  int threads = 0;
  std::string out;
  std::uint64_t frames = 0;
  bool probe = false;
  double probe_period_s = 5;
  bool probe_alpha = true;
  bool window = false;
  bool opengl = false;
  gl::Draw draw = gl::Draw::Auto;
  std::size_t max_gaussians = stream::kMaxGaussians;
  double max_kbps = 0;
  std::string record_file, packet_log;
  PathOptions path;

  void bind(bus::ParameterBinder& parameters);
  /// A window's pictures are drawn in its context, if it takes them, unless they are to be compared with the engine's,
  /// under whose light only a rasteriser draws.
  [[nodiscard]] bool draws_through_opengl() const { return (window || opengl) && !probe; }
};

}  // namespace splatbus::viewer
