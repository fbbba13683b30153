#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <set>
#include <span>
#include <string>

#include "bus/memory_pool.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "capture-bridge/blindness.h"
#include "capture-bridge/engines.h"
#include "capture-bridge/forwarder.h"
#include "capture-bridge/input_worker.h"
#include "capture-bridge/new_share.h"
#include "capture-bridge/probe_table.h"
#include "capture-bridge/rig_control.h"
#include "capture-bridge/round_sharing.h"
#include "capture-bridge/trainer_watch.h"
#include "wire/engine_generated.h"
#include "wire/viewer_poses.h"

namespace splatbus::capture_bridge {

/// Counters of the bridge, as heartbeats show them.
struct BridgeCounters {
  std::uint64_t frames = 0, frames_lost = 0;
  std::uint64_t frames_followed = 0;   ///< of engines that follow, with the version that they show
  std::uint64_t frames_unmatched = 0;  ///< of such, dropped: no version shows the same
  std::uint64_t refused = 0;           ///< messages that make no sense
  std::uint64_t glances = 0;           ///< input pictures that were sampled before their round was there
  std::uint64_t inputs_blind = 0;      ///< input pictures of what is right before the camera
  std::uint64_t ranges = 0;            ///< pictures of depth cubes
  std::uint64_t poses_dropped = 0;     ///< of more viewers than can be followed
  std::uint64_t inputs = 0, references = 0, probes = 0, probes_dropped = 0, light_depths = 0;
};

/// The service: asks the engines for cameras and hands their frames on. One thread calls step(); sampling runs on
/// another, and in bridges that help. On a bus there is one that steps at a time.
class CaptureBridge {
 public:
  /// `parameters` outlive the bridge. Input frames are kept and sampled where `backend` says. Throws std::runtime_error
  /// when it cannot be had.
  CaptureBridge(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters, Device backend = Device::Cpu);

  /// Handles what arrives within `timeout`, then what is due. Throws bus::Error when the device has failed for good.
  void step(std::chrono::milliseconds timeout);

  /// Which engines and other bridges there are, as the broker sees it.
  void take(const wire::Liveness& liveness) {
    engines_.take(liveness);
    sharing_.take(liveness);
  }
  [[nodiscard]] const Engines& engines() const { return engines_; }

  [[nodiscard]] const BridgeCounters& counters() const { return counters_; }
  [[nodiscard]] InputStatistics input_statistics() const { return worker_.statistics(); }
  [[nodiscard]] const RoundSharing& sharing() const { return sharing_; }
  /// Bytes of pictures and depth maps that have passed through host memory.
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_copied_bytes_; }
  [[nodiscard]] const bus::Subscriber& subscriber() const { return subscriber_; }
  [[nodiscard]] std::size_t cameras() { return rigs_.cameras().requests().size(); }
  [[nodiscard]] std::size_t viewers() const { return viewers_.all().size(); }

 private:
  struct TrainerWatches {
    TrainerWatch references, inputs;
  };
  /// A frame of an engine that follows, whose version may come.
  struct WaitingFrame {
    bus::Message message;
    SceneState shows;
    Camera camera;
    std::uint64_t request_id = 0;
    std::int64_t came_ns = 0;
  };
  void subscribe();
  void subscribe_to_helpers();
  void handle_frame(const wire::EngineFrame& frame, const bus::Message& message);
  void follow_frame(const wire::EngineFrame& frame, const bus::Message& message);
  void use_waiting_frames(std::int64_t now_ns);
  void drop_unmatched(const WaitingFrame& frame);
  /// Of the scene that is shown.
  void use_frame(const wire::EngineFrame& frame, const bus::Message& message);
  void handle_input(const bus::Message& message, const wire::EngineFrame& frame);
  void handle_light_depth(const bus::Message& message, const wire::EngineFrame& frame);
  void handle_probe_frame(const bus::Message& message, const wire::EngineFrame& frame);
  void handle_range(const bus::Message& message, const wire::EngineFrame& frame);
  void handle_pose(const wire::ViewerPose& pose);
  void handle_probe(const wire::ViewerProbe& asked, const bus::Message& message);
  void handle_trainer_stats(const wire::TrainerStats& stats, const bus::Message& message, TrainerWatches& watches);
  void handle_grid_state(const wire::GridState& state, const bus::Message& message);

  void update_rigs(std::int64_t now_ns);
  void update_rounds(std::int64_t now_ns);
  void update_light_maps(std::int64_t now_ns);
  void refresh_pictures(std::int64_t now_ns);
  void update_probes(std::int64_t now_ns);
  /// Of its newest frames; with `all` of all, whatever has been handed on before.
  void submit_round(InputRig& rig, bool all);
  void submit_glance(InputRig& rig);
  /// For this bridge or another one to sample.
  void submit(InputJob job);
  void share_rounds(std::int64_t now_ns);
  void publish_cameras();
  /// To all engines where none is named.
  void publish_cameras(std::span<const CameraRequest> cameras, const std::string& engine);

  std::shared_ptr<bus::Context> context_;
  bus::LiveOptions<Options> options_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  Forwarder forwarder_;
  Engines engines_;
  bool divided_ = false;
  std::deque<WaitingFrame> waiting_;
  std::uint64_t tried_version_ = 0;  // with those that wait
  std::uint64_t waiting_refused_ = 0;
  RigControl rigs_;
  ProbeTable probes_;
  TrainerWatches trainer_watches_, standby_watches_;
  NewShareWatch new_shares_;
  BridgeCounters counters_;
  bus::MemoryPool input_pictures_;
  BlindnessTest blindness_;
  std::atomic<std::uint64_t> host_copied_bytes_ = 0;

  ViewerPoses viewers_;
  std::int64_t next_light_maps_ns_ = 0;  // when those that have not come are asked for again
  /// Pictures of one role, which are rendered anew as the scene changes.
  struct Refresh {
    StalestFirst pictures;
    std::int64_t next_ns = 0;
  };
  void refresh(Refresh& of, CameraRole role, double rate_hz, std::int64_t now_ns);
  Refresh refreshed_inputs_, refreshed_references_;
  /// Views that were published for the trainer. References may come at a rate, while inputs stand for long.
  struct Published {
    std::set<std::uint32_t> camera_ids;
    std::int64_t last_ns = 0;
  };
  Published references_published_, inputs_published_;

  RoundSharing sharing_;
  InputWorker worker_;  // last: its thread uses the context
};

/// The service's main loop, until a stop is asked for.
void run(bus::ServiceContext& service);

}  // namespace splatbus::capture_bridge
