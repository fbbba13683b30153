#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "evaluation_setup.h"
#include "gaussians/camera.h"
#include "link_schedule.h"
#include "network_link.h"

namespace splatbus::cli {

struct StreamRunOptions {
  EvaluationSetup setup;
  double seconds = 46;     ///< from the first picture on; with several `viewers`, of each stage
  double every_s = 2;      ///< between rounds of pictures
  bool walk = false;       ///< the walk through a world, else the demo's scene and a viewer that orbits
  bool still = false;      ///< sun and objects rest; not with `walk`
  double period_s = 30;    ///< of the orbit
  double speed_m_s = 1.4;  ///< of the walk
  LinkKind link = LinkKind::Auto;
  LinkShape shape;
  double cut_s = 0;                   ///< of a cut half-way; 0: none
  std::optional<double> viewer_kbps;  ///< the streamer's; nullopt: found out over a link with a rate, else its default
  std::vector<std::size_t> viewers{1};
};

/// Where the viewer looks from, and where it is compared with the engine.
struct StreamPlan {
  LaunchPlan launch;
  std::function<Camera(double seconds)> viewer;  ///< seconds since it began to move
  std::vector<Camera> held_out;                  ///< that are compared; empty: the viewer's own, wherever it is
};

/// The demo's services, or those of the walk, without viewer and gateway; the streamer listens on `port` of the
/// loopback address too. Throws std::runtime_error.
[[nodiscard]] StreamPlan plan_stream(const StreamRunOptions& options, const bus::Address& address, std::uint16_t port);

}  // namespace splatbus::cli
