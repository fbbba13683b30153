#pragma once

#include <cstdint>
#include <string>

#include "viewer/model_saver.h"
#include "viewer/painter.h"
#include "viewer/shown.h"
#include "viewer/stream_receiver.h"
#include "viewer/ui/figures.h"
#include "viewer/window.h"

namespace splatbus::viewer {

/// What a window's figures say of the stream, and what its menu asks of it.
class WindowStream {
 public:
  /// Both outlive this. `folder` for what is saved; empty: the current one.
  WindowStream(Window& window, StreamReceiver& receiver, std::string folder, std::size_t max_gaussians,
               std::uint32_t max_kbps);

  /// A turn of who draws; `scene_arrived_ns` of the newest scene, 0: none has.
  void turn(std::int64_t now_ns, const Painter& painter, std::size_t held, std::int64_t scene_arrived_ns);

 private:
  void apply_budget();
  void save();
  void show_figures(std::int64_t now_ns, const Painter& painter, std::size_t held, std::int64_t scene_arrived_ns);

  Window& window_;
  StreamReceiver& receiver_;
  std::string folder_;
  std::size_t max_gaussians_;
  std::uint32_t max_kbps_;
  ByteRate rate_;
  std::int64_t figures_ns_ = 0;
  ModelSaver saver_;
};

}  // namespace splatbus::viewer
