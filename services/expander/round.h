#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "bus/subscriber.h"
#include "expander/insertion.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"

namespace splatbus::expander {

/// What a round of capture/input says beside its samples. Meanings: schemas/capture.fbs, CaptureInput.
struct RoundInfo {
  std::uint64_t rig_generation = 0;
  std::int64_t capture_ns = 0, publish_ns = 0;
  std::vector<Camera> cameras;
  SceneState scene;
};

/// A round whose samples still lie where its sender put them, in either kind of memory; sizes and types agree, values
/// may be garbage.
struct IncomingRound : RoundInfo {
  std::uint32_t count = 0;
  /// position, normal, albedo, color: f32 [count][3]; spacing: f32 [count]; object_id: u32 [count]
  std::vector<bus::TensorView> tensors;
};

/// Nullopt when the round's slab is gone or has moved on. Throws bus::Error, naming what is wrong, when the message
/// lies or has more samples than `max_samples`.
[[nodiscard]] std::optional<IncomingRound> open_round(const bus::Message& message, std::size_t max_samples);

/// A round in memory of our own. What is not invalid is finite, with a unit normal and a positive spacing.
struct Round : RoundInfo {
  device::Buffer<std::byte> memory;
  Samples samples{};  ///< in `memory`
  std::uint32_t invalid = 0;
};

/// Copies a round to the stream's device and validates it. Null when a slab has moved on meanwhile. Adds to
/// `host_bytes` what has not stayed on the device. Throws as insertion.h.
[[nodiscard]] std::unique_ptr<Round> take_round(const IncomingRound& incoming, device::StreamView stream,
                                                std::atomic<std::uint64_t>& host_bytes);

}  // namespace splatbus::expander
