#pragma once

#include <flatbuffers/flatbuffers.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "bus/memory_pool.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "capture-bridge/input_worker.h"
#include "wire/sampling_generated.h"

namespace splatbus::capture_bridge {

/// A round as another bridge has it to sample.
struct ForeignRound {
  std::uint64_t job = 0;
  std::vector<InputView> views;  ///< of one size; of what they say only camera, background, objects and pictures
  ObjectTransforms objects;      ///< of the round's frame
  SamplingOptions options;
};

/// The pictures of a job's views, for sampling/round; they hold as long as the views do.
[[nodiscard]] std::vector<bus::TensorSource> round_tensors(const InputJob& job);

/// What sampling/round says beside them.
[[nodiscard]] flatbuffers::Offset<wire::SamplingRound> write_round(flatbuffers::FlatBufferBuilder& builder,
                                                                   flatbuffers::Offset<wire::Header> header,
                                                                   const std::string& to, std::uint64_t job_id,
                                                                   const InputJob& job);

/// Copies a round into memory of the pool. Adds to `host_bytes` what did not stay on the device. Nullopt when a picture
/// is gone already. Throws bus::Error or std::runtime_error, naming what is wrong, when the message lies.
[[nodiscard]] std::optional<ForeignRound> read_round(const wire::SamplingRound& round, const bus::Message& message,
                                                     bus::MemoryPool& pool, std::atomic<std::uint64_t>& host_bytes);

}  // namespace splatbus::capture_bridge
