#include "capture-bridge/input_publisher.h"

#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kRingSlots = 4;
constexpr std::size_t kBytesASample = 15 * sizeof(float) + 2 * sizeof(std::uint32_t);
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned

}  // namespace

InputPublisher::InputPublisher(const std::shared_ptr<bus::Context>& context, Device kind, const RoundSizes& expected)
    : publisher_(context),
      ring_(context, "input", kRingSlots,
            expected.samples * kBytesASample + expected.views * expected.pixels * sizeof(float) + kRingSlack, kind) {}

void InputPublisher::publish(std::span<const InputViewPointer> views, const InputView& newest,
                             std::uint64_t rig_generation, const RoundSamples& round) {
  using bus::ElementType;
  const auto n = static_cast<std::uint32_t>(round.size);
  const Camera& camera = views.front()->camera;
  std::vector<bus::TensorSource> sources{
      {"position", {n, 3}, ElementType::F32, round.position},
      {"normal", {n, 3}, ElementType::F32, round.normal},
      {"albedo", {n, 3}, ElementType::F32, round.albedo},
      {"color", {n, 3}, ElementType::F32, round.color},
      {"footprint", {n}, ElementType::F32, round.footprint_m},
      {"spacing", {n}, ElementType::F32, round.spacing_m},
      {"cosine", {n}, ElementType::F32, round.cosine},
      {"object_id", {n}, ElementType::U32, round.object_id},
      {"camera", {n}, ElementType::U32, round.camera},
      {"depth",
       {static_cast<std::uint32_t>(views.size()), camera.height, camera.width},
       ElementType::F32,
       round.depth_m},
  };
  for (bus::TensorSource& source : sources) source.memory = round.memory;
  const bus::MessageInfo info{.capture_ns = newest.capture_ns, .tensors = ring_.write(sources)};
  publisher_.publish(topics::kCaptureInput, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    std::vector<wire::Camera> cameras;
    cameras.reserve(views.size());
    for (const InputViewPointer& view : views) cameras.push_back(to_wire(view->camera));
    const auto cameras_offset = builder.CreateVectorOfStructs(cameras);
    const auto scene =
        to_wire(builder, SceneState{.light = newest.light, .objects = newest.objects}, newest.frame, newest.time_s);
    return wire::CreateCaptureInput(builder, header, rig_generation, cameras_offset, scene);
  });
}

}  // namespace splatbus::capture_bridge
