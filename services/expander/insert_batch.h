#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "device/stream.h"
#include "expander/insertion.h"
#include "gaussians/light.h"

namespace splatbus::expander {

/// New Gaussians for one model/insert. Copies share the channels, which nobody changes once the batch is made.
struct InsertBatch {
  std::uint64_t batch = 0;  ///< unique within this process
  std::int64_t capture_ns = 0;
  SceneState scene;  ///< of the samples
  std::uint32_t count = 0;
  Device memory = Device::Cpu;      ///< of `data`
  std::shared_ptr<std::byte> data;  ///< insert_channels_at(data, count) says what lies where

  [[nodiscard]] std::size_t size() const { return count; }
  [[nodiscard]] std::size_t bytes() const { return count * kInsertBytes; }
  [[nodiscard]] InsertChannels channels() const { return insert_channels_at(data.get(), count); }
};

/// A batch of `count` Gaussians whose channels are still to be written.
[[nodiscard]] InsertBatch allocate_batch(device::StreamView stream, std::uint32_t count);

/// Frames of a scene's objects, ascending by id.
[[nodiscard]] std::vector<ObjectFrame> frames_of(const ObjectTransforms& objects);

}  // namespace splatbus::expander
