#include "capture-bridge/input_publisher.h"

#include <algorithm>

#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kRingSlots = 4;
constexpr std::size_t kBytesASample = 15 * sizeof(float) + 2 * sizeof(std::uint32_t);
constexpr std::size_t kRingSlack = 4096;  // tensors are aligned

std::vector<float> stacked(const std::vector<std::vector<float>>& planes) {
  std::vector<float> all;
  for (const auto& plane : planes) all.insert(all.end(), plane.begin(), plane.end());
  return all;
}

}  // namespace

InputPublisher::InputPublisher(const std::shared_ptr<bus::Context>& context, std::size_t most_samples,
                               std::size_t depth_pixels)
    : publisher_(context, "capture/input"),
      ring_(context, "input", kRingSlots, most_samples * kBytesASample + depth_pixels * sizeof(float) + kRingSlack) {}

void InputPublisher::publish(std::span<const InputViewPointer> views, const InputView& newest,
                             std::uint64_t rig_generation, const SampledRound& round) {
  using bus::ElementType;
  const SampleSet& samples = round.samples;
  const auto n = static_cast<std::uint32_t>(samples.size());
  const std::vector<float> depth = stacked(round.depth_m);
  const Camera& camera = views.front()->camera;
  const std::vector<bus::TensorSource> sources{
      {"position", {n, 3}, ElementType::F32, samples.position.data()},
      {"normal", {n, 3}, ElementType::F32, samples.normal.data()},
      {"albedo", {n, 3}, ElementType::F32, samples.albedo.data()},
      {"color", {n, 3}, ElementType::F32, samples.color.data()},
      {"footprint", {n}, ElementType::F32, samples.footprint_m.data()},
      {"spacing", {n}, ElementType::F32, samples.spacing_m.data()},
      {"cosine", {n}, ElementType::F32, samples.cosine.data()},
      {"object_id", {n}, ElementType::U32, samples.object_id.data()},
      {"camera", {n}, ElementType::U32, samples.camera.data()},
      {"depth",
       {static_cast<std::uint32_t>(views.size()), camera.height, camera.width},
       ElementType::F32,
       depth.data()},
  };
  bus::MessageInfo info{.schema = "CaptureInput/1", .capture_ns = newest.capture_ns, .tensors = ring_.write(sources)};
  publisher_.publish(info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    std::vector<wire::Camera> cameras;
    cameras.reserve(views.size());
    for (const InputViewPointer& view : views) cameras.push_back(to_wire(view->camera));
    const auto cameras_offset = builder.CreateVectorOfStructs(cameras);
    const auto objects = to_wire(builder, newest.objects);
    const auto light = to_wire(builder, newest.light);
    return wire::CreateCaptureInput(builder, header, newest.frame, newest.time_s, rig_generation, cameras_offset,
                                    objects, light);
  });
}

}  // namespace splatbus::capture_bridge
