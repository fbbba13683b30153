#include "trainer/insert_batch.h"

#include <algorithm>
#include <cmath>

namespace splatbus::trainer {

namespace {

bool all_below(const std::vector<float>& planes, std::size_t channels, std::size_t count, std::size_t row,
               float limit) {
  for (std::size_t c = 0; c < channels; ++c) {
    if (!(std::abs(planes[c * count + row]) <= limit)) return false;  // also when it is NaN
  }
  return true;
}

/// Length of the row's vector, over `channels` planes.
float length(const std::vector<float>& planes, std::size_t channels, std::size_t count, std::size_t row) {
  float sum = 0;
  for (std::size_t c = 0; c < channels; ++c) sum += planes[c * count + row] * planes[c * count + row];
  return std::sqrt(sum);
}

bool valid_row(const InsertBatch& b, std::size_t row) {
  const std::size_t n = b.count;
  if (!all_below(b.mean, 3, n, row, kMaxDistance_m) || !all_below(b.log_scale, 3, n, row, kMaxAnyLogScale))
    return false;
  if (!all_below(b.rotation, 4, n, row, kMaxAny) || !all_below(b.opacity_logit, 1, n, row, kMaxAny)) return false;
  if (!all_below(b.albedo, 3, n, row, kMaxAny) || !all_below(b.visibility, 1, n, row, kMaxAny)) return false;
  if (!all_below(b.normal, 3, n, row, kMaxAnyNormal)) return false;
  return length(b.rotation, 4, n, row) > kMinRotationLength &&
         std::abs(length(b.normal, 3, n, row) - 1.0F) <= kUnitTolerance;
}

/// Moves row keep[i] to row i of each plane, and the planes together.
template <class T>
void gather(std::vector<T>& planes, std::size_t channels, std::size_t count, const std::vector<std::size_t>& keep) {
  std::vector<T> kept(channels * keep.size());
  for (std::size_t c = 0; c < channels; ++c) {
    for (std::size_t i = 0; i < keep.size(); ++i) kept[c * keep.size() + i] = planes[c * count + keep[i]];
  }
  planes = std::move(kept);
}

void normalise(std::vector<float>& planes, std::size_t channels, std::size_t count) {
  for (std::size_t row = 0; row < count; ++row) {
    const float inverse = 1.0F / length(planes, channels, count, row);
    for (std::size_t c = 0; c < channels; ++c) planes[c * count + row] *= inverse;
  }
}

void clamp(std::vector<float>& planes, float low, float high) {
  for (float& value : planes) value = std::clamp(value, low, high);
}

}  // namespace

InsertRows InsertBatch::rows() const {
  if (device_memory) return device_rows;
  return {.stride = count,
          .mean = mean.data(),
          .log_scale = log_scale.data(),
          .rotation = rotation.data(),
          .opacity_logit = opacity_logit.data(),
          .albedo = albedo.data(),
          .normal = normal.data(),
          .visibility = visibility.data(),
          .object_id = object_id.data(),
          .cell = cell.data()};
}

std::size_t insert_rows_bytes(std::size_t stride) {
  std::size_t bytes = 0;
  InsertRows rows;
  for_each_plane(rows, [&](const char* /*name*/, const auto* planes, std::size_t channels) {
    bytes += channels * stride * sizeof(*planes);
  });
  return bytes;
}

InsertRows insert_rows_at(const std::byte* memory, std::size_t stride) {
  InsertRows rows{.stride = stride};
  for_each_plane(rows, [&]<class T>(const char* /*name*/, const T*& planes, std::size_t channels) {
    planes = reinterpret_cast<const T*>(memory);
    memory += channels * stride * sizeof(T);
  });
  return rows;
}

void keep_valid_rows(InsertBatch& batch) {
  const std::size_t announced = batch.count;
  std::vector<std::size_t> keep;
  keep.reserve(announced);
  for (std::size_t row = 0; row < announced; ++row) {
    if (valid_row(batch, row)) keep.push_back(row);
  }
  if (keep.size() < announced) {
    for_each_plane(batch, [&](const char* /*name*/, auto& planes, std::size_t channels) {
      gather(planes, channels, announced, keep);
    });
  }
  batch.count = keep.size();
  batch.dropped = announced - keep.size();
  normalise(batch.rotation, 4, batch.count);
  normalise(batch.normal, 3, batch.count);
  clamp(batch.log_scale, kMinLogScale, kMaxLogScale);
  clamp(batch.opacity_logit, -kMaxOpacityLogit, kMaxOpacityLogit);
  clamp(batch.albedo, 0.0F, 1.0F);
  clamp(batch.visibility, 0.0F, 1.0F);
}

}  // namespace splatbus::trainer
