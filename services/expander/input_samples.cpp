#include "expander/input_samples.h"

#include <fmt/format.h>

#include <cmath>

#include "wire/capture_generated.h"
#include "wire/convert.h"

namespace splatbus::expander {

namespace {

constexpr std::size_t kMostSamples = 8U << 20U;
constexpr std::size_t kMostCameras = 4096;
constexpr float kLargestSpacing_m = 1000;

bool finite(const glm::vec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

/// A tensor of `count` rows into a vector. False when its slab has moved on. Throws when the message has none.
template <class Element, class Row>
bool copy_rows(const bus::Message& message, const char* name, std::size_t count, std::vector<Row>& rows) {
  std::vector<std::uint32_t> shape{static_cast<std::uint32_t>(count)};
  if (sizeof(Row) > sizeof(Element)) shape.push_back(sizeof(Row) / sizeof(Element));
  const auto tensor = message.tensor(name, bus::ElementTypeOf<Element>::value, shape);
  if (!tensor) return false;
  rows.resize(count);
  return tensor->copy(rows.data());
}

bool sound(const InputSamples& samples, std::size_t i) {
  return finite(samples.position[i]) && finite(samples.normal[i]) && finite(samples.albedo[i]) &&
         finite(samples.color[i]) && std::isfinite(samples.cosine[i]) &&
         std::abs(glm::length(samples.normal[i]) - 1) < 0.05F && samples.spacing_m[i] > 0 &&
         samples.spacing_m[i] < kLargestSpacing_m && samples.camera[i] < samples.cameras.size();
}

}  // namespace

void drop_garbage(InputSamples& samples) {
  std::size_t kept = 0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    if (!sound(samples, i)) continue;
    samples.position[kept] = samples.position[i];
    samples.normal[kept] = glm::normalize(samples.normal[i]);
    samples.albedo[kept] = glm::clamp(samples.albedo[i], 0.0F, 1.0F);
    samples.color[kept] = glm::max(samples.color[i], 0.0F);
    samples.spacing_m[kept] = samples.spacing_m[i];
    samples.cosine[kept] = samples.cosine[i];
    samples.object_id[kept] = samples.object_id[i];
    samples.camera[kept] = samples.camera[i];
    ++kept;
  }
  samples.dropped += samples.size() - kept;
  for (auto* vectors : {&samples.position, &samples.normal, &samples.albedo, &samples.color}) vectors->resize(kept);
  for (auto* scalars : {&samples.spacing_m, &samples.cosine}) scalars->resize(kept);
  for (auto* ids : {&samples.object_id, &samples.camera}) ids->resize(kept);
}

std::optional<InputSamples> decode_input(const bus::Message& message) {
  const auto& input = message.root<wire::CaptureInput>("CaptureInput/1");
  const auto positions = message.tensor("position", bus::ElementType::F32, {0, 3});
  const auto depth = message.tensor("depth", bus::ElementType::F32, {0, 0, 0});
  if (!positions || !depth) return std::nullopt;
  const std::size_t count = positions->dim(0);
  if (count > kMostSamples)
    throw bus::Error(fmt::format("capture/input: {} samples, more than {}", count, kMostSamples));
  if (input.cameras() == nullptr || input.cameras()->size() != depth->dim(0) || depth->dim(0) > kMostCameras) {
    throw bus::Error(fmt::format("capture/input: {} cameras with {} depth maps",
                                 input.cameras() == nullptr ? 0 : input.cameras()->size(), depth->dim(0)));
  }
  InputSamples samples;
  samples.frame = input.frame();
  samples.rig_generation = input.rig_generation();
  samples.time_s = input.time_s();
  samples.capture_ns = input.header()->capture_ns();
  samples.objects = from_wire(input.objects());
  samples.light = from_wire(*input.light());
  samples.cameras.reserve(input.cameras()->size());
  for (const wire::Camera* camera : *input.cameras()) samples.cameras.push_back(from_wire(*camera));
  samples.height = depth->dim(1);
  samples.width = depth->dim(2);
  samples.depth_m.resize(depth->elements());
  const bool whole = depth->copy(samples.depth_m.data()) &&
                     copy_rows<float>(message, "position", count, samples.position) &&
                     copy_rows<float>(message, "normal", count, samples.normal) &&
                     copy_rows<float>(message, "albedo", count, samples.albedo) &&
                     copy_rows<float>(message, "color", count, samples.color) &&
                     copy_rows<float>(message, "spacing", count, samples.spacing_m) &&
                     copy_rows<float>(message, "cosine", count, samples.cosine) &&
                     copy_rows<std::uint32_t>(message, "object_id", count, samples.object_id) &&
                     copy_rows<std::uint32_t>(message, "camera", count, samples.camera);
  if (!whole) return std::nullopt;
  drop_garbage(samples);
  return samples;
}

}  // namespace splatbus::expander
