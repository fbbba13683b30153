#include "expander/input_samples.h"

#include <cmath>

#include "bus/memory.h"

namespace splatbus::expander {

namespace {

bool finite(const glm::vec3& v) {
  return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

template <class Row>
bool copy_rows(const bus::TensorView& tensor, std::vector<Row>& rows, std::atomic<std::uint64_t>& host_bytes) {
  rows.resize(tensor.bytes() / sizeof(Row));
  return bus::copy_tensor(tensor, rows.data(), Device::Cpu, host_bytes);
}

bool sound(const InputSamples& samples, std::size_t i) {
  return finite(samples.position[i]) && finite(samples.normal[i]) && finite(samples.albedo[i]) &&
         finite(samples.color[i]) && std::isfinite(samples.cosine[i]) &&
         std::abs(glm::length(samples.normal[i]) - 1) < kUnitTolerance && samples.spacing_m[i] > 0 &&
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

std::optional<InputSamples> copy_samples(const IncomingRound& round, std::atomic<std::uint64_t>& host_bytes) {
  InputSamples samples;
  static_cast<RoundInfo&>(samples) = round;
  const bool whole =
      copy_rows(round.depth, samples.depth_m, host_bytes) && copy_rows(round.position, samples.position, host_bytes) &&
      copy_rows(round.normal, samples.normal, host_bytes) && copy_rows(round.albedo, samples.albedo, host_bytes) &&
      copy_rows(round.color, samples.color, host_bytes) && copy_rows(round.spacing, samples.spacing_m, host_bytes) &&
      copy_rows(round.cosine, samples.cosine, host_bytes) &&
      copy_rows(round.object_id, samples.object_id, host_bytes) && copy_rows(round.camera, samples.camera, host_bytes);
  if (!whole) return std::nullopt;
  drop_garbage(samples);
  return samples;
}

}  // namespace splatbus::expander
