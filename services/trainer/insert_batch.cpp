#include "trainer/insert_batch.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/glm.hpp>
#include <string>

#include "bus/error.h"
#include "wire/convert.h"
#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

constexpr std::uint32_t kMaxRows = 1U << 22;
constexpr float kMaxDistance_m = 1e6F;
constexpr float kMinLogScale = -16.0F, kMaxLogScale = 8.0F;  // a tenth of a micrometre to three kilometres
constexpr float kMaxOpacityLogit = 12.0F;
constexpr float kUnitTolerance = 0.05F;

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
  if (!all_below(b.mean, 3, n, row, kMaxDistance_m) || !all_below(b.log_scale, 3, n, row, 100.0F)) return false;
  if (!all_below(b.rotation, 4, n, row, 1e3F) || !all_below(b.opacity_logit, 1, n, row, 1e3F)) return false;
  if (!all_below(b.albedo, 3, n, row, 1e3F) || !all_below(b.visibility, 1, n, row, 1e3F)) return false;
  if (!all_below(b.normal, 3, n, row, 2.0F)) return false;
  return length(b.rotation, 4, n, row) > 1e-3F && std::abs(length(b.normal, 3, n, row) - 1.0F) <= kUnitTolerance;
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

template <class T>
bool read_plane(const bus::Message& message, const char* name, std::vector<std::uint32_t> shape, std::vector<T>& out) {
  const auto tensor = message.tensor(name, bus::ElementTypeOf<T>::value, shape);
  if (!tensor) {
    const auto* tensors = message.header().tensors();
    const bool announced =
        tensors != nullptr && std::any_of(tensors->begin(), tensors->end(),
                                          [&](const wire::Tensor* t) { return t->name()->string_view() == name; });
    if (!announced)
      throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": tensor \"" + name +
                       "\" is missing");
    return false;
  }
  out.resize(tensor->elements());
  return tensor->copy(out.data());
}

}  // namespace

InsertRows InsertBatch::rows() const {
  if (device_memory) return device_rows;
  return {.memory = bus::MemoryKind::Host,
          .stride = count,
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

std::size_t InsertBatch::bytes() const {
  const std::size_t floats = mean.size() + log_scale.size() + rotation.size() + opacity_logit.size() + albedo.size() +
                             normal.size() + visibility.size();
  return floats * sizeof(float) + object_id.size() * sizeof(std::uint32_t) + cell.size() * sizeof(std::uint64_t);
}

void keep_valid_rows(InsertBatch& batch) {
  const std::size_t announced = batch.count;
  std::vector<std::size_t> keep;
  keep.reserve(announced);
  for (std::size_t row = 0; row < announced; ++row) {
    if (valid_row(batch, row)) keep.push_back(row);
  }
  if (keep.size() < announced) {
    gather(batch.mean, 3, announced, keep);
    gather(batch.log_scale, 3, announced, keep);
    gather(batch.rotation, 4, announced, keep);
    gather(batch.opacity_logit, 1, announced, keep);
    gather(batch.albedo, 3, announced, keep);
    gather(batch.normal, 3, announced, keep);
    gather(batch.visibility, 1, announced, keep);
    gather(batch.object_id, 1, announced, keep);
    gather(batch.cell, 1, announced, keep);
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

InsertReading read_insert(const bus::Message& message) {
  const auto& insert = message.root<wire::ModelInsert>("ModelInsert/1");
  const auto mean = message.tensor("mean", bus::ElementType::F32, {3, 0});
  InsertReading reading;
  InsertBatch& batch = reading.batch;
  batch.epoch = message.header().epoch();
  batch.batch = insert.batch();
  batch.light = from_wire(*insert.light());
  batch.objects = from_wire(insert.objects());
  const std::uint32_t rows = mean ? mean->dim(1) : 0;
  if (rows > kMaxRows) {
    throw bus::Error(message.topic() + ": " + std::to_string(rows) + " Gaussians in one batch, more than " +
                     std::to_string(kMaxRows));
  }
  if (mean && rows == 0) return reading;
  const bool whole = read_plane(message, "mean", {3, rows}, batch.mean) &&
                     read_plane(message, "log_scale", {3, rows}, batch.log_scale) &&
                     read_plane(message, "rotation", {4, rows}, batch.rotation) &&
                     read_plane(message, "opacity_logit", {1, rows}, batch.opacity_logit) &&
                     read_plane(message, "albedo", {3, rows}, batch.albedo) &&
                     read_plane(message, "normal", {3, rows}, batch.normal) &&
                     read_plane(message, "visibility", {1, rows}, batch.visibility) &&
                     read_plane(message, "object_id", {rows}, batch.object_id) &&
                     read_plane(message, "cell", {rows}, batch.cell);
  if (!whole) {
    reading.lost = true;
    return reading;
  }
  batch.count = rows;
  keep_valid_rows(batch);
  return reading;
}

}  // namespace splatbus::trainer
