#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <stop_token>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/log_sink.h"
#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "gateway/foxglove/hub.h"
#include "gateway/foxglove/utc_clock.h"
#include "gateway/parameters.h"
#include "model/live_scene.h"

namespace splatbus::gateway::foxglove {

// Channels that are made of the bus's topics, besides those for each camera: "foxglove/cameras/<name>/calibration" and
// ".../picture", ".../depth".
inline constexpr std::string_view kTransforms = "foxglove/transforms";
inline constexpr std::string_view kViewers = "foxglove/viewers/calibration";
inline constexpr std::string_view kProbeCalibration = "foxglove/probe/calibration";
inline constexpr std::string_view kProbePicture = "foxglove/probe/picture";
inline constexpr std::string_view kProbeDepth = "foxglove/probe/depth";
inline constexpr std::string_view kPoints = "foxglove/points";
inline constexpr std::string_view kLog = "foxglove/log";

/// Reads from the bus what the hub's clients want, and only that, and brings it into their form. On one thread.
class Feed {
 public:
  /// The references outlive it.
  Feed(std::shared_ptr<bus::Context> context, Hub& hub, const Options& options);

  /// Until `stop`. What goes wrong with a message is logged.
  void run(const std::stop_token& stop);

 private:
  using Channels = std::set<std::string>;  ///< by topic
  struct Source {
    bus::Subscriber subscriber;
    std::map<std::string, bus::Message> held;  ///< the newest latched ones, by key
  };

  /// One turn; false when nobody is there any more.
  bool serve();
  /// Subscribes to what `wanted` needs, and to nothing else; who is new gets what is held.
  void arrange(const Hub::Wanted& wanted);
  void wait();
  void receive(Source& source);
  /// For `channels` only: of what is wanted all, or those that have become so.
  void take(const bus::Message& message, const Channels& channels);
  void take_as_it_is(const bus::Message& message);
  void take_topics(const wire::Topics& topics);
  void take_heartbeat(const wire::Heartbeat& heartbeat);
  void take_liveness(const wire::Liveness& liveness);
  void take_log(const bus::Message& message);
  /// Sets of cameras by one who asks for them no longer go.
  void follow_asker(const bus::Message& message, Source& source);
  void take_cameras(const bus::Message& message, const Channels& channels);
  void take_scene(const bus::Message& message);
  void take_pose(const bus::Message& message, const Channels& channels);
  void take_reference(const bus::Message& message, const Channels& channels);
  void take_probe(const bus::Message& message, const Channels& channels);
  void send_picture(const bus::Message& message, const std::string& topic, const std::string& frame);
  void send_depth(const bus::Message& message, const std::string& topic, const std::string& frame);
  [[nodiscard]] bool picture_is_due(const std::string& topic) const;
  void deliver_picture(const std::string& topic, std::uint64_t time, Payload payload);
  void send_points(std::int64_t now_ns);
  /// Of the message's origin.
  [[nodiscard]] std::uint64_t time_of(const bus::Message& message);
  [[nodiscard]] std::uint64_t utc(std::int64_t monotonic_ns) { return clock_.utc(monotonic_ns); }

  std::shared_ptr<bus::Context> context_;
  Hub& hub_;
  const Options& options_;
  UtcClock clock_;
  bus::Publisher publisher_;
  std::map<std::string, Source> sources_;             ///< by topic
  Hub::Wanted numbers_;                               ///< of what is wanted
  Channels wanted_;                                   ///< the same without numbers
  std::map<std::string, std::string> schemas_;        ///< Header.schema of each topic of the bus that is offered
  using Cameras = std::map<std::string, CameraRole>;  ///< by name
  Cameras cameras_;                                   ///< that are offered
  std::pair<std::string, std::uint64_t> cameras_by_;  ///< who has asked for them: source and epoch
  std::map<std::string, Cameras> cameras_of_;         ///< by the engine that is asked; "": all are
  std::map<std::string, std::int64_t> next_picture_ns_;
  std::optional<LiveScene> scene_;
  std::int64_t next_points_ns_ = 0, next_time_ns_ = 0;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::gateway::foxglove
