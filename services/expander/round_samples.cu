// A round's samples as they come: where they lie in its memory, and which of them make sense.
#include "device/parallel.h"
#include "expander/insertion.h"

namespace splatbus::expander {

using device::Buffer;
using device::for_each_index;
using device::StreamView;
using math::Vec3;

namespace {

SPLATBUS_PORTABLE bool finite(const Vec3& v) {
  return math::is_finite(v.x) && math::is_finite(v.y) && math::is_finite(v.z);
}

struct ValidateSample {
  Samples samples;
  std::uint32_t* invalid;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const Vec3 normal = samples.normal[i], albedo = samples.albedo[i], color = samples.color[i];
    const float spacing_m = samples.spacing_m[i];
    const bool valid = finite(samples.position[i]) && finite(normal) && finite(albedo) && finite(color) &&
                       fabsf(length(normal) - 1) < kUnitTolerance && spacing_m > 0 && spacing_m < kMaxSpacing_m;
    if (!valid) {
      samples.spacing_m[i] = 0;
      device::atomic_add(invalid, 1U);
      return;
    }
    samples.normal[i] = normalized(normal);
    samples.albedo[i] = {math::clamped(albedo.x, 0, 1), math::clamped(albedo.y, 0, 1), math::clamped(albedo.z, 0, 1)};
    samples.color[i] = {math::larger(color.x, 0), math::larger(color.y, 0), math::larger(color.z, 0)};
  }
};

}  // namespace

Samples samples_at(std::byte* memory, std::uint32_t count) {
  auto* const position = reinterpret_cast<Vec3*>(memory);
  auto* const spacing_m = reinterpret_cast<float*>(position + std::size_t{4} * count);
  return {position,
          position + count,
          position + std::size_t{2} * count,
          position + std::size_t{3} * count,
          spacing_m,
          reinterpret_cast<std::uint32_t*>(spacing_m + count),
          count};
}

std::uint32_t validate(StreamView stream, const Samples& samples) {
  Buffer<std::uint32_t> invalid(stream, 1);
  invalid.clear();
  for_each_index(stream, samples.count, ValidateSample{samples, invalid.data()});
  return invalid.to_host().front();
}

}  // namespace splatbus::expander
