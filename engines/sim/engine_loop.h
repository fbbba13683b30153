#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>

#include "sdk/splatbus_engine.h"
#include "sim/renderer.h"
#include "sim/schedule.h"

namespace splatbus::sim {

struct EngineLoopOptions {
  double fps = 10;           ///< frame n is at engine time n / fps
  std::uint64_t frames = 0;  ///< ends after so many; 0: never
};

struct CloseEngine {
  void operator()(splatbus_engine* engine) const { splatbus_engine_close(engine); }
};
using EngineHandle = std::unique_ptr<splatbus_engine, CloseEngine>;

/// Joins the bus through the SDK. An empty address is the default bus. Throws std::runtime_error.
[[nodiscard]] EngineHandle open_engine(const std::string& address, const std::string& name);

/// The built-in engine's main loop: frames by absolute deadlines, each rendering the cameras that are due. A frame
/// whose deadline has passed before it could begin is skipped, so engine time keeps pace with real time.
class EngineLoop {
 public:
  EngineLoop(splatbus_engine& engine, Renderer& renderer, const EngineLoopOptions& options);

  /// Until `stop` or the last frame.
  void run(const std::atomic<bool>& stop);

 private:
  void wait_until(std::int64_t deadline_ns, const std::atomic<bool>& stop);
  void render_frame(std::uint64_t frame);
  void render_camera(std::uint64_t frame, const splatbus_camera_request& request);
  const Pictures& pictures_for(const splatbus_camera_request& request, const splatbus_camera& camera);
  void count(const char* name, double value);

  splatbus_engine& engine_;
  Renderer& renderer_;
  EngineLoopOptions options_;
  Schedule schedule_;

  struct Rendered {
    splatbus_camera camera;
    std::uint32_t buffers;
    std::uint64_t scene_version;
    Pictures pictures;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Rendered> rendered_;  ///< by role and id, of repeated requests
  std::uint64_t cameras_submitted_ = 0, cameras_rendered_ = 0, cameras_failed_ = 0, frames_skipped_ = 0;
  double render_ms_ = 0;  ///< a camera, an exponential mean
};

}  // namespace splatbus::sim
