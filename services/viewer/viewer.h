#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <opencv2/core.hpp>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "bus/backend.h"
#include "bus/log_sink.h"
#include "bus/parameters.h"
#include "stream/playout.h"
#include "viewer/camera_path.h"
#include "viewer/loss_limit.h"
#include "viewer/options.h"
#include "viewer/painter.h"
#include "viewer/picture_age.h"
#include "viewer/stream_receiver.h"
#include "viewer/succession.h"
#include "viewer/window.h"
#include "viewer/window_stream.h"

namespace splatbus::viewer {

/// What surrounds a viewer: a service on the bus, or a program of its own on another machine.
struct ViewerHost {
  std::string name;
  std::string endpoint;                        ///< of the streamer
  std::function<std::string()> find_endpoint;  ///< as ClientOptions has it; null: `endpoint` it is
  Device device = Device::Cpu;
  std::stop_token stop;
  std::function<void(const std::string& name, double value)> counter;
  std::function<void(const std::string& text)> detail;
  std::optional<Place> place{};  ///< of the viewer before: it goes on from there
};

/// Shows what the streamer sends: PNG frames, a window, or only figures against the engine's own pictures.
class Viewer {
 public:
  /// Throws bus::Error when the endpoint is malformed, or a window was asked for and there is no display.
  Viewer(const bus::Parameters& parameters, ViewerHost host);

  /// Until the host says stop or the window is closed.
  void run();

  /// CLOCK_MONOTONIC when the first picture with a Gaussian in it was ready; 0 before.
  [[nodiscard]] std::int64_t first_picture_ns() const { return first_picture_ns_; }
  /// Where it is; not while run() is on its way.
  [[nodiscard]] Place place() const;

 private:
  [[nodiscard]] cv::Mat draw(const Camera& camera, const SceneState& scene);
  /// In the window, at the display's own rate.
  [[nodiscard]] bool draws_at_display_rate() const { return window_ && opengl_; }
  /// What has arrived; true when it shows.
  bool take();
  /// Draws in another context from now on. Throws `lost` where that was done too often, bus::Error where there is none.
  void renew_context(const ContextLost& lost);
  /// False when there is nothing new to show.
  bool show(bool changed);
  void frame_all();
  /// What the window's menu asks for; true when it is another picture.
  bool serve_window();
  /// Takes over parameters that have changed.
  void refresh_options();
  void answer_probes();
  /// Whether the visibility that is held is that of the probe's instant, or it does not come.
  [[nodiscard]] bool sees_as_probe(const ProbeAnswer& probe) const;
  void ask_probe(std::int64_t now_ns);
  /// Counts and says what cannot be written: a full disk ends nobody.
  void write_picture(const std::string& name, const cv::Mat& picture);
  void report();

  bus::LiveOptions<Options> options_;
  ViewerHost host_;
  stream::Playout playout_;
  PictureAges ages_;
  CameraPath path_;
  PathClock path_clock_;
  PathOptions path_options_;  ///< that path_ was asked for with
  std::optional<PathRecorder> recorder_;
  Camera camera_;
  std::unique_ptr<Window> window_;
  bool opengl_;
  std::unique_ptr<Painter> painter_;  // in the window's context
  StreamReceiver receiver_;
  Shown shown_;
  std::optional<WindowStream> window_stream_;
  std::int64_t begin_ns_, first_picture_ns_ = 0, next_probe_ns_ = 0, last_report_ns_ = 0;
  std::int64_t drawn_ns_ = 0, scene_arrived_ns_ = 0;
  std::uint64_t frames_ = 0, next_probe_id_, compared_ = 0, unwritten_ = 0;
  bus::LogLimiter log_limiter_;
  metrics::Quality last_quality_;
  double draw_ms_ = 0;
  LossLimit losses_;
  bool awaits_all_ = false;           ///< what is to be drawn is not there yet, and the last picture stands
  bool unsettled_ = false;            ///< the last picture was on the way to one that is still to be drawn
  std::optional<ProbeAnswer> probe_;  ///< that is to be answered
};

}  // namespace splatbus::viewer
