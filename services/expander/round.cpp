#include "expander/round.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::expander {

namespace {

constexpr std::size_t kMaxCameras = 4096;

}  // namespace

std::optional<IncomingRound> open_round(const bus::Message& message, std::size_t max_samples) {
  using bus::ElementType;
  const auto& input = message.root<wire::CaptureInput>();
  const auto position = message.tensor("position", ElementType::F32, {0, 3});
  if (!position) {
    if (!message.announces("position")) throw bus::Error("capture/input: no tensor \"position\"");
    return std::nullopt;
  }
  const std::uint32_t count = position->dim(0);
  if (count > max_samples) {
    throw bus::Error(fmt::format("capture/input: {} samples, more than max_samples = {}", count, max_samples));
  }
  const std::size_t cameras = input.cameras() == nullptr ? 0 : input.cameras()->size();
  if (cameras > kMaxCameras) throw bus::Error(fmt::format("capture/input: {} cameras", cameras));

  IncomingRound round;
  round.count = count;
  const auto add = [&](const char* name, ElementType type, const std::vector<std::uint32_t>& shape) {
    if (auto tensor = message.tensor(name, type, shape)) round.tensors.push_back(std::move(*tensor));
  };
  for (const char* name : {"position", "normal", "albedo", "color"}) add(name, ElementType::F32, {count, 3});
  add("spacing", ElementType::F32, {count});
  add("object_id", ElementType::U32, {count});
  if (round.tensors.size() != 6) return std::nullopt;

  round.rig_generation = input.rig_generation();
  round.capture_ns = input.header()->capture_ns();
  round.publish_ns = input.header()->publish_ns();
  round.scene = from_wire(*input.scene());
  round.cameras.reserve(cameras);
  for (std::size_t i = 0; i < cameras; ++i) {
    round.cameras.push_back(from_wire(*input.cameras()->Get(static_cast<flatbuffers::uoffset_t>(i))));
  }
  return round;
}

std::unique_ptr<Round> take_round(const IncomingRound& incoming, device::StreamView stream,
                                  std::atomic<std::uint64_t>& host_bytes) {
  auto round = std::make_unique<Round>();
  static_cast<RoundInfo&>(*round) = incoming;
  round->memory = device::Buffer<std::byte>(stream, std::size_t{incoming.count} * kSampleBytes);
  round->samples = samples_at(round->memory.data(), incoming.count);
  const Samples& samples = round->samples;
  const std::array<void*, 6> to = {samples.position, samples.normal,    samples.albedo,
                                   samples.color,    samples.spacing_m, samples.object_id};
  for (std::size_t i = 0; i < to.size(); ++i) {
    const bus::TensorView& tensor = incoming.tensors[i];
    if (stream.on_cuda()) {
      device::copy(stream, to[i], tensor.data(), tensor.bytes());
    } else {
      bus::copy_memory(to[i], Device::Cpu, tensor.data(), tensor.memory(), tensor.bytes());
    }
    if (!stream.on_cuda() || tensor.memory() == Device::Cpu) host_bytes += tensor.bytes();
  }
  bus::finish_copies();  // what came from a device to the host
  round->invalid = validate(stream, samples);
  const bool whole = std::all_of(incoming.tensors.begin(), incoming.tensors.end(),
                                 [](const bus::TensorView& tensor) { return tensor.still_valid(); });
  return whole ? std::move(round) : nullptr;
}

}  // namespace splatbus::expander
