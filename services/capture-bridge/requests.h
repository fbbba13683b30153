#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "capture-bridge/input_view.h"
#include "gaussians/camera.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge {

struct CameraRequest {
  Camera camera;
  wire::EngineBuffer buffers = wire::EngineBuffer::Color;
  float rate_hz = 0;  ///< 0: once for each request_id
  std::uint64_t request_id = 0;
  std::uint32_t light_id = 0, light_map = 0;  ///< role Light
  float extent_m = 0;                         ///< of a cascade; 0: the scene
};

/// What engine/cameras says: all cameras that the engine shall render. Request ids grow and are never used twice.
class CameraSet {
 public:
  /// Ids start above `first_request_id`: an engine that outlives this process must not take new requests for old ones.
  explicit CameraSet(std::uint64_t first_request_id) : last_request_id_(first_request_id) {}

  /// Replaces all cameras of a role. Cameras that are as before keep their request, all others get a new request id.
  /// Returns the cameras that have left (their ids are in the set no longer).
  std::vector<Camera> replace(CameraRole role, std::span<const Camera> cameras, wire::EngineBuffer buffers,
                              float rate_hz);
  /// The same; the request ids are this set's.
  std::vector<Camera> replace(CameraRole role, std::span<const CameraRequest> wanted);

  /// New request ids for these cameras of a role: render them again.
  void reissue(CameraRole role, std::span<const std::uint32_t> ids);
  void reissue_all(CameraRole role);

  /// Adds or replaces one camera; returns its request id.
  std::uint64_t add(const Camera& camera, wire::EngineBuffer buffers, float rate_hz);
  std::uint64_t add(CameraRequest request);
  void remove(CameraRole role, std::uint32_t id);
  /// The camera of this role and id stands elsewhere now, under a new request id.
  void move(CameraRole role, const Camera& camera);

  [[nodiscard]] std::vector<CameraRequest> of_role(CameraRole role) const;
  /// Whether that camera is asked for as it is; by the other, whether this is its request.
  [[nodiscard]] bool asks_for(const Camera& camera) const;
  [[nodiscard]] bool asks_for(CameraRole role, std::uint32_t camera_id, std::uint64_t request_id) const;
  [[nodiscard]] const std::vector<CameraRequest>& requests() const { return requests_; }

  /// True once after any change.
  bool take_changed();

 private:
  std::uint64_t last_request_id_;
  std::vector<CameraRequest> requests_;
  bool changed_ = true;
};

/// Says which camera's picture to render anew because the scene has changed since. Times are CLOCK_MONOTONIC
/// nanoseconds.
class StalestFirst {
 public:
  /// A camera's picture has come, which shows this version of the scene.
  void arrived(std::uint32_t camera_id, std::uint64_t scene_version) { pictures_[camera_id] = {scene_version, {}}; }
  void forget(std::uint32_t camera_id) { pictures_.erase(camera_id); }
  void clear() { pictures_.clear(); }

  /// The camera whose picture is of the oldest scene version before `scene_version`, and for which no newer one is on
  /// its way (asked for less than kPatienceNs ago). It counts as asked for at `now_ns`.
  [[nodiscard]] std::optional<std::uint32_t> take(std::uint64_t scene_version, std::int64_t now_ns);

  static constexpr std::int64_t kPatienceNs = 2'000'000'000;

 private:
  struct Picture {
    std::uint64_t scene_version = 0;
    std::optional<std::int64_t> asked_anew_ns;
  };
  std::map<std::uint32_t, Picture> pictures_;  // by camera id
};

using InputViewPointer = std::shared_ptr<const InputView>;

/// Collects the frames of one input rig into rounds. A round is ready when every camera has delivered a frame since the
/// round before, or, so that a lost frame never blocks it, some time after its first frame; frames that come later make
/// another round together with those that were there. Once every camera's frame has been handed on, those that are
/// rendered again because the scene changed are rounds of their own, and do not wait as long: what has appeared is in
/// them. Times are CLOCK_MONOTONIC nanoseconds.
class InputRound {
 public:
  /// A rig in a new place, or one that has grown: forgets all frames but those that still answer. A rig generation is
  /// never 0, and has one place of one rig.
  void begin(std::span<const CameraRequest> requests, std::uint64_t rig_generation);
  /// The same rig under other request ids: keeps the frames that are there.
  void renew(std::span<const CameraRequest> requests);
  /// A camera that the rig has no more: its frame goes, and none is waited for.
  void drop(std::uint32_t camera_id);

  /// Whether a frame answers a request of this rig.
  [[nodiscard]] bool awaits(std::uint32_t camera_id, std::uint64_t request_id) const;
  /// Takes a frame in. False when it answers no request of this rig (an older rig's frame).
  bool add(std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view, std::int64_t now_ns);

  /// The same, of a camera that has gone on alone: no reason for another round.
  bool replace(std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view);

  /// True when there is something to hand on: a full round, or a partial one whose first frame is `deadline_ns` old.
  [[nodiscard]] bool ready(std::int64_t now_ns, std::int64_t deadline_ns) const;
  /// Every camera's frame has been handed on.
  [[nodiscard]] bool refreshes() const { return handed_on_whole_; }
  /// All frames of the rig so far, by camera id; the next round starts.
  [[nodiscard]] std::vector<InputViewPointer> take();
  /// Those that have come since the last round.
  [[nodiscard]] std::vector<InputViewPointer> take_fresh();

  [[nodiscard]] bool shows(std::uint32_t camera_id) const;  ///< a frame of it is there
  /// Cameras without any frame.
  [[nodiscard]] std::vector<std::uint32_t> missing() const;
  [[nodiscard]] bool empty() const;  ///< no camera has delivered yet
  [[nodiscard]] std::uint64_t rig_generation() const { return rig_generation_; }
  [[nodiscard]] std::vector<InputViewPointer> views() const;
  [[nodiscard]] std::size_t cameras() const { return slots_.size(); }

 private:
  struct Slot {
    std::uint32_t camera_id = 0;
    std::uint64_t request_id = 0;
    InputViewPointer view;
    bool fresh = false;  // arrived since the last round
  };
  [[nodiscard]] Slot* find(std::uint32_t camera_id, std::uint64_t request_id);

  std::vector<Slot> slots_;
  std::optional<std::int64_t> first_fresh_ns_;
  bool handed_on_incomplete_ = false;
  bool handed_on_whole_ = false;
  std::uint64_t rig_generation_ = 0;
};

}  // namespace splatbus::capture_bridge
