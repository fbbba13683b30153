#include <thrust/copy.h>

#include "device/buffer.h"
#include "device/parallel.h"
#include "trainer/insert_rows.h"

namespace splatbus::trainer {

namespace {

template <int kChannels>
struct Row {
  float value[kChannels];

  SPLATBUS_PORTABLE_MEMBER Row(const float* planes, std::size_t stride, std::uint32_t row) {
    for (int c = 0; c < kChannels; ++c) value[c] = planes[c * stride + row];
  }
  SPLATBUS_PORTABLE_MEMBER void store(const float* planes, std::size_t stride, std::uint32_t row) const {
    auto* const to = const_cast<float*>(planes);  // the caller's to write
    for (int c = 0; c < kChannels; ++c) to[c * stride + row] = value[c];
  }
  /// False when any is NaN.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool all_below(float limit) const {
    bool below = true;
    for (int c = 0; c < kChannels; ++c) below = below && fabsf(value[c]) <= limit;
    return below;
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float length() const {
    float sum = 0;
    for (int c = 0; c < kChannels; ++c) sum += value[c] * value[c];
    return sqrtf(sum);
  }
  SPLATBUS_PORTABLE_MEMBER Row& normalise() {
    const float inverse = 1.0F / length();
    for (int c = 0; c < kChannels; ++c) value[c] *= inverse;
    return *this;
  }
  SPLATBUS_PORTABLE_MEMBER Row& clamp(float low, float high) {
    for (int c = 0; c < kChannels; ++c) value[c] = math::clamped(value[c], low, high);
    return *this;
  }
};

struct IsValid {
  InsertRows from;

  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint32_t row) const {
    const std::size_t s = from.stride;
    const Row<4> rotation(from.rotation, s, row);
    const Row<3> normal(from.normal, s, row);
    return Row<3>(from.mean, s, row).all_below(kMaxDistance_m) &&
           Row<3>(from.log_scale, s, row).all_below(kMaxAnyLogScale) && rotation.all_below(kMaxAny) &&
           Row<1>(from.opacity_logit, s, row).all_below(kMaxAny) && Row<3>(from.albedo, s, row).all_below(kMaxAny) &&
           Row<1>(from.visibility, s, row).all_below(kMaxAny) && normal.all_below(kMaxAnyNormal) &&
           rotation.length() > kMinRotationLength && fabsf(normal.length() - 1.0F) <= kUnitTolerance;
  }
};

struct Gather {
  InsertRows from, to;
  const std::uint32_t* keep;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t row = keep[i];
    const std::size_t s = from.stride, t = to.stride;
    Row<3>(from.mean, s, row).store(to.mean, t, i);
    Row<3>(from.log_scale, s, row).clamp(kMinLogScale, kMaxLogScale).store(to.log_scale, t, i);
    Row<4>(from.rotation, s, row).normalise().store(to.rotation, t, i);
    Row<1>(from.opacity_logit, s, row).clamp(-kMaxOpacityLogit, kMaxOpacityLogit).store(to.opacity_logit, t, i);
    Row<3>(from.albedo, s, row).clamp(0, 1).store(to.albedo, t, i);
    Row<3>(from.normal, s, row).normalise().store(to.normal, t, i);
    Row<1>(from.visibility, s, row).clamp(0, 1).store(to.visibility, t, i);
    const_cast<std::uint32_t*>(to.object_id)[i] = from.object_id[row];
  }
};

}  // namespace

std::uint32_t keep_valid_rows(device::StreamView stream, const InsertRows& announced, std::uint32_t rows,
                              const InsertRows& kept) {
  device::Buffer<std::uint32_t> keep(stream, rows);
  const auto count = device::with_policy(stream, [&](auto&& policy) {
    const auto first = thrust::make_counting_iterator(std::uint32_t{0});
    return static_cast<std::uint32_t>(thrust::copy_if(policy, first, first + rows, keep.data(), IsValid{announced}) -
                                      keep.data());
  });
  device::for_each_index(stream, count, Gather{announced, kept, keep.data()});
  stream.wait();
  return count;
}

}  // namespace splatbus::trainer
