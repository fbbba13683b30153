#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <vector>

#include "bus/log_sink.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "stream/stream_model.h"
#include "stream/streamer_choice.h"
#include "streamer/endpoint.h"
#include "streamer/model_follower.h"
#include "streamer/parameters.h"
#include "streamer/sharing.h"
#include "streamer/viewer_hub.h"

namespace splatbus::streamer {

/// The streamer service: follows the published model and the scene, and keeps viewers' replicas near them.
class Streamer {
 public:
  /// Binds the endpoints. Throws bus::Error.
  explicit Streamer(bus::ServiceContext& service);

  /// Until `service.stop`; then, where another streamer is, until viewers have gone there, for drain_s at most.
  void run();
  /// One turn of run() at `now_ns` (CLOCK_MONOTONIC): takes what has come, ticks, waits for that, reports when it is
  /// due, sends what the sockets take.
  void turn(std::int64_t now_ns);

  [[nodiscard]] const std::vector<std::string>& endpoints() const { return endpoint_.bound(); }

 private:
  struct Visibility {
    std::uint64_t scene_version = 0;
    std::vector<std::uint32_t> light_ids;
    std::vector<std::uint8_t> of_index;  ///< [light_ids][indices]
    bool sent = false;
    // Where replicas share the pages:
    std::uint32_t page_indices = 0;
    std::vector<std::uint8_t> covered;             ///< of each page; empty: it is all there
    std::vector<std::uint64_t> version_of_page{};  ///< the same
  };

  void subscribe();
  void take_scene(const wire::SceneUpdate& body);
  /// Takes what has come on the bus, and sends what of it viewers are waiting for.
  void take_messages(std::int64_t now_ns);
  void forward_probe(const wire::CaptureProbe& body, const bus::Message& message);
  /// What is due; a tick is begun, and ended by a later call.
  void step(std::int64_t now_ns);
  void begin_tick(std::int64_t now_ns);
  void end_tick(std::int64_t now_ns);
  /// Viewers get what ticks here and elsewhere have made.
  void pass_updates(std::int64_t now_ns);
  [[nodiscard]] bool is_followed() const { return hub_.is_followed() || sharing_.others_are_followed(); }
  void take_visibility(const wire::RelightVisibility& body, const bus::Message& message);
  void merge_visibility(const wire::RelightVisibility& body, const std::vector<std::uint8_t>& part);
  void send_visibility(std::int64_t now_ns);
  void publish_statistics(std::int64_t now_ns);
  void publish_offer();
  void close_load(const WireStatistics::Window& window);
  void wait_and_step();
  void drain();
  // succession.cpp
  /// Where the one before has left its stream, it goes on.
  void adopt_handover();
  /// Where no other streamer goes on with it: for the next process of this name.
  void leave_behind();
  void say_what_is_served(const ModelFollower::Result& result);
  [[nodiscard]] HubEvents events();

  bus::ServiceContext& service_;
  bus::LiveOptions<Options> options_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  Endpoint endpoint_;
  stream::PacketWriter writer_;
  stream::StreamModel model_;
  ViewerHub hub_;

  std::optional<bus::Message> announcement_;   ///< model/published that is not open yet
  std::uint64_t scene_version_ = 0;            // of the newest scene that was sent on
  std::uint64_t observed_generation_ = 0;      ///< of the model that model_ has observed
  std::map<std::uint64_t, Visibility> relit_;  ///< by generation: the newest of each
  std::size_t held_gaussians_ = 0;
  std::int64_t visibility_ns_ = 0;  ///< when its balance was renewed
  double visibility_balance_bytes_ = 0;
  std::int64_t next_visibility_ns_ = 0, next_tick_ns_ = 0, next_stats_ns_ = 0;
  bool blocked_ = false;          ///< somebody's queue is full
  bool full_ = false;             ///< viewers take no more of the model
  double balance_bytes_ = 0;      ///< of the budget; negative when a tick went over it
  ModelFollower::Result ticked_;  ///< by the last tick
  /// What the last window cost.
  struct Load {
    int ticks = 0;
    double encode_ms = 0;           ///< CPU time of the thread that ticks
    std::int64_t begin_cpu_ns = 0;  ///< of the thread that sends
    double encode_ms_a_tick = 0, send_ms_a_tick = 0, tick_ms = 0, bytes_per_s = 0;  ///< of the window before
  };
  Load load_;
  stream::StreamerChoice others_;
  Sharing sharing_;
  std::int64_t now_ns_ = 0;
  bool draining_ = false;
  bus::LogLimiter log_limiter_;
  ModelFollower follower_;  ///< last: its thread uses model_
};

}  // namespace splatbus::streamer
