#pragma once

#include <atomic>
#include <cstdint>
#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "sdk/splatbus_engine.h"
#include "sim/device_readback.h"
#include "sim/renderer.h"
#include "sim/schedule.h"

namespace splatbus::sim {

struct EngineLoopOptions {
  double fps = 10;  ///< frame n is at engine time n / fps
  /// After so long in a frame's pictures the rest waits for the next frame, all but depth maps, probes and one picture:
  /// a machine that cannot carry them all still shows a scene that moves.
  double pictures_s = 0.1;
  /// Frame 0 is at the start of the machine's monotonic clock, not of run(): engines of one machine show one time.
  bool shared_clock = false;
  std::uint64_t frames = 0;                    ///< ends after so many; 0: never
  std::function<void()> before_frame = [] {};  ///< may change the renderer's scene
};

struct CloseEngine {
  void operator()(splatbus_engine* engine) const { splatbus_engine_close(engine); }
};
using EngineHandle = std::unique_ptr<splatbus_engine, CloseEngine>;

/// Joins the bus through the SDK, with frames in `memory`. An empty address is the default bus. Throws
/// std::runtime_error.
[[nodiscard]] EngineHandle open_engine(const std::string& address, const std::string& name,
                                       splatbus_memory memory = SPLATBUS_MEMORY_HOST);

/// The built-in engine's main loop: frames by absolute deadlines, each rendering the cameras that are due. A frame
/// whose deadline has passed before it could begin is skipped, so engine time keeps pace with real time. A camera that
/// is asked for between two frames for the first time is rendered at once, as a part of the frame that stands.
class EngineLoop {
 public:
  /// Pictures are taken by `readback`, or, when it is null, through host memory. All three live longer.
  EngineLoop(splatbus_engine& engine, Renderer& renderer, DeviceReadback* readback, const EngineLoopOptions& options);

  /// Until `stop` or the last frame.
  void run(const std::atomic<bool>& stop);

 private:
  void wait_until(std::int64_t deadline_ns, const std::atomic<bool>& stop);
  void render_frame(std::uint64_t frame);
  void render_newcomers();
  /// With `bounded` within pictures_s.
  void render_cameras(std::uint64_t frame, const std::vector<splatbus_camera_request>& requests, bool bounded);
  /// The first of them that are rendered before one waits for the device. Returns how many.
  std::size_t render_next(std::uint64_t frame, std::span<const splatbus_camera_request> requests);
  /// What is drawn and waits for the device.
  struct Drawn {
    std::vector<splatbus_camera_request> requests;
    std::vector<splatbus_frame> frames;
  };
  /// Through host memory it is submitted at once.
  void draw(std::uint64_t frame, const splatbus_camera_request& request, Drawn& drawn);
  void submit_drawn(std::uint64_t frame, const Drawn& drawn);
  void failed(std::uint64_t frame, const splatbus_camera_request& request, const std::exception& why);
  /// Of the instant, without its images.
  [[nodiscard]] splatbus_frame frame_of(std::uint64_t frame, const splatbus_camera_request& request,
                                        const LightCamera& view) const;
  void submit(std::span<const splatbus_frame> frames);
  /// What has changed since anything was submitted, where no camera has said it.
  void submit_scene(std::uint64_t frame);
  const Pictures& pictures_for(const splatbus_camera_request& request, const LightCamera& view);
  [[nodiscard]] Schedule::DepthVersion depth_versions() const;
  void count_render(std::int64_t begin_ns, std::size_t cameras);
  void count(const char* name, double value);
  [[nodiscard]] double time_of(std::uint64_t frame) const { return static_cast<double>(frame) / options_.fps; }

  splatbus_engine& engine_;
  Renderer& renderer_;
  DeviceReadback* readback_;
  EngineLoopOptions options_;
  Schedule schedule_;
  std::optional<std::uint64_t> standing_frame_;

  struct Rendered {
    splatbus_camera camera;
    std::uint32_t buffers;
    std::uint64_t scene_version;
    Pictures pictures;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Rendered> rendered_;  ///< by role and id, of repeated requests
  std::uint64_t cameras_submitted_ = 0, cameras_rendered_ = 0, cameras_failed_ = 0, cameras_postponed_ = 0;
  std::uint64_t frames_skipped_ = 0;
  std::uint64_t submitted_scene_ = 0;  ///< the renderer's scene version that was submitted last
  double render_ms_ = 0;               ///< a camera, an exponential mean
};

}  // namespace splatbus::sim
