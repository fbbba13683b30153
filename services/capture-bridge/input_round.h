#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "capture-bridge/camera_set.h"
#include "capture-bridge/input_view.h"

namespace splatbus::capture_bridge {

using InputViewPointer = std::shared_ptr<const InputView>;

/// Collects the frames of one input rig into rounds. A round is ready when every camera has delivered a frame since the
/// round before, or, so that a lost frame never blocks it, some time after its first frame; frames that come later make
/// another round together with those that were there. Times are CLOCK_MONOTONIC nanoseconds.
class InputRound {
 public:
  /// A rig in a new place: forgets all frames. A rig generation is never 0.
  void begin(std::span<const CameraRequest> requests);
  /// The same rig under other request ids: keeps the frames that are there.
  void renew(std::span<const CameraRequest> requests);

  /// Takes a frame in. False when it answers no request of this rig (an older rig's frame).
  bool add(std::uint32_t camera_id, std::uint64_t request_id, InputViewPointer view, std::int64_t now_ns);

  /// True when there is something to hand on: a full round, or a partial one whose first frame is `deadline_ns` old.
  [[nodiscard]] bool ready(std::int64_t now_ns, std::int64_t deadline_ns) const;
  /// All frames of the rig so far, by camera id; the next round starts.
  [[nodiscard]] std::vector<InputViewPointer> take();

  /// Cameras without any frame.
  [[nodiscard]] std::vector<std::uint32_t> missing() const;
  [[nodiscard]] bool empty() const;  ///< no camera has delivered yet
  [[nodiscard]] std::uint64_t rig_generation() const { return rig_generation_; }
  [[nodiscard]] std::vector<InputViewPointer> views() const;

 private:
  struct Slot {
    std::uint32_t camera_id = 0;
    std::uint64_t request_id = 0;
    InputViewPointer view;
    bool fresh = false;  // arrived since the last round
  };
  std::vector<Slot> slots_;
  std::optional<std::int64_t> first_fresh_ns_;
  bool handed_on_incomplete_ = false;
  std::uint64_t rig_generation_ = 0;
};

}  // namespace splatbus::capture_bridge
