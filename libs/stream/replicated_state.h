#pragma once

#include <cstdint>
#include <vector>

#include "gaussians/light.h"
#include "stream/light_rows.h"
#include "stream/packets.h"
#include "stream/quantized.h"
#include "stream/quantized_scene.h"

namespace splatbus::stream {

/// What every viewer holds after broadcast packet `sequence` of `epoch`. The streamer keeps the same: both change it
/// only by apply(), so that they agree bit for bit.
struct ReplicatedState {
  StreamLayout layout;
  QuantizedGaussians gaussians;
  QuantizedScene quantized_scene;
  SceneState scene;  ///< of quantized_scene
  SceneInstant instant;
  LightRows light_rows;                  ///< of scene.light.sources, gaussians.count() long; the sun's is an attribute
  std::uint64_t visibility_version = 0;  ///< scene version of the Gaussians' visibility; 0: the model's own
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;
};

/// What apply() changed.
struct Change {
  enum class Kind : std::uint8_t { Nothing, Appended, Values, Seen, Removed, Objects, Scene };
  Kind kind = Kind::Nothing;
  Attribute attribute{};             ///< Values
  std::vector<std::uint32_t> slots;  ///< Appended, Values, Seen, Removed, Objects: ascending
  std::uint32_t light_id = 0;        ///< Seen: not the sun
  bool lights_changed = false;       ///< Scene: there are others
};

/// Applies Snapshot (appending), TensorDelta, Remove, GaussianOrder, ObjectIds, Scene or LightVisibility. Throws
/// StreamError, with the state as it was, when anything in the packet cannot be. Does not look at epoch and does not
/// change `sequence`. `max_gaussians` bounds what is held.
Change apply(ReplicatedState& state, const ParsedPacket& packet, std::size_t max_gaussians = kMaxGaussians);

}  // namespace splatbus::stream
