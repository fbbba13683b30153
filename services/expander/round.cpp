#include "expander/round.h"

#include <fmt/format.h>

#include "bus/error.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::expander {

namespace {

constexpr std::size_t kMostSamples = 8U << 20U;
constexpr std::size_t kMostCameras = 4096;

}  // namespace

std::optional<IncomingRound> open_round(const bus::Message& message) {
  using bus::ElementType;
  const auto& input = message.root<wire::CaptureInput>();
  auto position = message.tensor("position", ElementType::F32, {0, 3});
  auto depth = message.tensor("depth", ElementType::F32, {0, 0, 0});
  if (!position || !depth) return std::nullopt;
  const std::uint32_t count = position->dim(0);
  if (count > kMostSamples)
    throw bus::Error(fmt::format("capture/input: {} samples, more than {}", count, kMostSamples));
  if (input.cameras() == nullptr || input.cameras()->size() != depth->dim(0) || depth->dim(0) > kMostCameras) {
    throw bus::Error(fmt::format("capture/input: {} cameras with {} depth maps",
                                 input.cameras() == nullptr ? 0 : input.cameras()->size(), depth->dim(0)));
  }
  auto normal = message.tensor("normal", ElementType::F32, {count, 3});
  auto albedo = message.tensor("albedo", ElementType::F32, {count, 3});
  auto color = message.tensor("color", ElementType::F32, {count, 3});
  auto spacing = message.tensor("spacing", ElementType::F32, {count});
  auto cosine = message.tensor("cosine", ElementType::F32, {count});
  auto object_id = message.tensor("object_id", ElementType::U32, {count});
  auto camera = message.tensor("camera", ElementType::U32, {count});
  if (!normal || !albedo || !color || !spacing || !cosine || !object_id || !camera) return std::nullopt;

  RoundInfo info;
  info.frame = input.scene()->frame();
  info.rig_generation = input.rig_generation();
  info.time_s = input.scene()->time_s();
  info.capture_ns = input.header()->capture_ns();
  info.publish_ns = input.header()->publish_ns();
  info.objects = from_wire(input.scene()->objects());
  info.light = from_wire(*input.scene()->light());
  info.cameras.reserve(input.cameras()->size());
  for (const wire::Camera* one : *input.cameras()) info.cameras.push_back(from_wire(*one));
  info.height = depth->dim(1);
  info.width = depth->dim(2);
  return IncomingRound{std::move(info),       count,
                       std::move(*position),  std::move(*normal),
                       std::move(*albedo),    std::move(*color),
                       std::move(*spacing),   std::move(*cosine),
                       std::move(*object_id), std::move(*camera),
                       std::move(*depth)};
}

}  // namespace splatbus::expander
