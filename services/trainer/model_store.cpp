#include "trainer/model_store.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <glm/glm.hpp>
#include <numbers>
#include <utility>

#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kSlot = 0;
constexpr float kShConstant = 0.28209479177387814F;

void remember(Structure& structure, std::uint64_t epoch, std::uint64_t batch) {
  if (structure.insert_epoch != epoch) {
    structure.insert_epoch = epoch;
    structure.batch_count = 0;
  }
  if (structure.batch_count == kRememberedBatches) {
    std::rotate(structure.batches.begin(), structure.batches.begin() + 1, structure.batches.end());
    --structure.batch_count;
  }
  structure.batches.at(structure.batch_count++) = batch;
}

}  // namespace

glm::vec3 radiance_dc(const InsertBatch& batch, std::size_t row) {
  const auto vec = [&](const std::vector<float>& planes) {
    return glm::vec3(planes[row], planes[batch.count + row], planes[2 * batch.count + row]);
  };
  const auto object = batch.objects.find(batch.object_id[row]);
  const glm::vec3 normal =
      object == batch.objects.end() ? vec(batch.normal) : object->second.rotation * vec(batch.normal);
  const float cosine = std::max(0.0F, glm::dot(normal, batch.light.sun_direction));
  const glm::vec3 direct = batch.light.sun_irradiance * (batch.visibility[row] * cosine / std::numbers::pi_v<float>);
  const glm::vec3 lit = vec(batch.albedo) * (glm::max(ambient_reflected(batch.light, normal), 0.0F) + direct);
  glm::vec3 dc{};
  for (int c = 0; c < 3; ++c) dc[c] = (srgb_from_linear(std::clamp(lit[c], 0.0F, 1.0F)) - 0.5F) / kShConstant;
  return dc;
}

bool ModelStore::holds(std::uint64_t epoch, std::uint64_t batch) const {
  if (epoch != structure_.insert_epoch) return epoch < structure_.insert_epoch;
  const auto end = structure_.batches.begin() + static_cast<std::ptrdiff_t>(structure_.batch_count);
  return std::find(structure_.batches.begin(), end, batch) != end;
}

void ModelStore::add_step(std::size_t views, double seconds) {
  header_->step += 1;
  header_->views += views;
  header_->optimizer_s += seconds;
}

bool ModelStore::set_visibility(std::uint64_t generation, std::span<const float> visibility) {
  const bool moved = generation < structure_.removal_generation || generation > structure_.generation;
  if (moved || visibility.size() > count()) return false;
  std::copy(visibility.begin(), visibility.end(), planes_.visibility);
  return true;
}

void ModelStore::change(const std::function<void()>& work) {
  slab_->begin_write(kSlot);
  const auto finish = [&] {
    structure_.generation += 1;
    commit();
    slot_generation_ = slab_->end_write(kSlot);
  };
  try {
    work();
  } catch (...) {
    structure_ = header_->structure.at(header_->current.load());
    finish();
    throw;
  }
  finish();
}

void ModelStore::commit() {
  const std::uint32_t next = 1 - header_->current.load();
  header_->structure.at(next) = structure_;
  header_->current.store(next, std::memory_order_release);
}

ModelStore::Columns ModelStore::append(const InsertBatch& batch) {
  if (holds(batch.epoch, batch.batch)) return {.first = count(), .count = 0};
  const std::size_t room = max_gaussians_ - std::min(max_gaussians_, count());
  const Columns columns{.first = count(), .count = std::min(batch.count, room)};
  if (columns.count < batch.count) {
    spdlog::warn("model: {} of {} Gaussians in batch {} are left out, the model has max_gaussians ({})",
                 batch.count - columns.count, batch.count, batch.batch, max_gaussians_);
  }
  reserve(columns.first + columns.count);
  write_columns(batch, columns.first, columns.count);
  structure_.next_gaussian_id += columns.count;
  structure_.count += columns.count;
  remember(structure_, batch.epoch, batch.batch);
  return columns;
}

void ModelStore::write_columns(const InsertBatch& batch, std::size_t first, std::size_t count) const {
  const std::size_t stride = planes_.capacity;
  const auto fill = [&](float* planes, int channel, const std::vector<float>& from, std::size_t channels) {
    for (std::size_t c = 0; c < channels; ++c) {
      std::copy_n(from.data() + c * batch.count, count,
                  planes + (static_cast<std::size_t>(channel) + c) * stride + first);
    }
  };
  float* const parameters = planes_.parameters;
  fill(parameters, ParameterLayout::kMean, batch.mean, 3);
  fill(parameters, ParameterLayout::kLogScale, batch.log_scale, 3);
  fill(parameters, ParameterLayout::kRotation, batch.rotation, 4);
  fill(parameters, ParameterLayout::kOpacityLogit, batch.opacity_logit, 1);
  const auto channels = static_cast<std::size_t>(layout().channels());
  for (std::size_t c = ParameterLayout::kAppearance; c < channels; ++c) {
    std::fill_n(parameters + c * stride + first, count, 0.0F);
  }
  if (layout().appearance == Appearance::Transfer) {
    fill(parameters, ParameterLayout::kAlbedo, batch.albedo, 3);
  } else {
    for (std::size_t row = 0; row < count; ++row) {
      const glm::vec3 dc = radiance_dc(batch, row);
      for (int c = 0; c < 3; ++c) {
        parameters[static_cast<std::size_t>(ParameterLayout::kAppearance + c) * stride + first + row] = dc[c];
      }
    }
  }
  for (std::size_t c = 0; c < channels; ++c) {
    std::copy_n(parameters + c * stride + first, count, planes_.average + c * stride + first);
  }
  fill(planes_.normal, 0, batch.normal, 3);
  fill(planes_.surface_point, 0, batch.mean, 3);
  fill(planes_.visibility, 0, batch.visibility, 1);
  std::copy_n(batch.object_id.data(), count, planes_.object_id + first);
  std::copy_n(batch.cell.data(), count, planes_.cell + first);
  std::fill_n(planes_.flags + first, count, 0U);
  for (std::size_t row = 0; row < count; ++row) {
    planes_.gaussian_id[first + row] = structure_.next_gaussian_id + row;
  }
}

ModelStore::Columns ModelStore::duplicate(const std::vector<std::uint32_t>& columns) {
  const std::size_t room = max_gaussians_ - std::min(max_gaussians_, count());
  const Columns added{.first = count(), .count = std::min(columns.size(), room)};
  reserve(added.first + added.count);
  for (std::size_t i = 0; i < added.count; ++i) {
    planes_.move_column(columns[i], added.first + i);
    planes_.gaussian_id[added.first + i] = structure_.next_gaussian_id++;
  }
  structure_.count += added.count;
  return added;
}

std::vector<std::uint32_t> ModelStore::remove(const std::vector<std::uint8_t>& dead) {
  std::vector<std::uint32_t> keep;
  keep.reserve(count());
  std::size_t end = count();
  for (std::size_t column = 0; column < end; ++column) {
    if (dead[column] == 0) {
      keep.push_back(static_cast<std::uint32_t>(column));
      continue;
    }
    while (end > column + 1 && dead[end - 1] != 0) --end;
    if (--end == column) break;
    planes_.move_column(end, column);
    keep.push_back(static_cast<std::uint32_t>(end));
  }
  if (keep.size() == count()) return keep;
  structure_.count = keep.size();
  structure_.removal_generation = structure_.generation + 1;
  structure_.frozen = static_cast<std::uint64_t>(
      std::count_if(planes_.flags, planes_.flags + keep.size(), [](std::uint32_t f) { return (f & kFrozen) != 0; }));
  return keep;
}

std::size_t ModelStore::set_frozen(const std::unordered_set<std::uint64_t>& cells, bool frozen) {
  std::size_t changed = 0;
  for (std::size_t i = 0; i < count(); ++i) {
    const bool is_frozen = (planes_.flags[i] & kFrozen) != 0;
    if (is_frozen == frozen || !cells.contains(planes_.cell[i])) continue;
    planes_.flags[i] ^= kFrozen;
    ++changed;
    if (!frozen) continue;
    for (std::size_t c = 0; c < static_cast<std::size_t>(layout().channels()); ++c) {
      planes_.parameters[c * planes_.capacity + i] = planes_.average[c * planes_.capacity + i];
    }
  }
  structure_.frozen = frozen ? structure_.frozen + changed : structure_.frozen - changed;
  return changed;
}

void ModelStore::publish(bus::Publisher& publisher) const {
  const auto stride = static_cast<std::uint32_t>(planes_.capacity);
  const std::byte* const start = slab_->slot_data(kSlot);
  bus::MessageInfo info{.schema = "ModelPublished/1", .latch = true};
  const auto add = [&](const char* name, const auto* plane, std::uint32_t channels) {
    using Element = std::remove_const_t<std::remove_pointer_t<decltype(plane)>>;
    std::vector<std::uint32_t> shape{stride};
    if (channels != 0) shape.insert(shape.begin(), channels);
    const std::size_t bytes = std::size_t{stride} * std::max(1U, channels) * sizeof(Element);
    const auto offset = static_cast<std::size_t>(reinterpret_cast<const std::byte*>(plane) - start);
    info.tensors.push_back({.name = name,
                            .shape = shape,
                            .type = bus::ElementTypeOf<Element>::value,
                            .span = slab_->span(kSlot, offset, bytes, slot_generation_)});
  };
  const auto channels = static_cast<std::uint32_t>(layout().channels());
  add("parameters", planes_.parameters, channels);
  add("average", planes_.average, channels);
  add("normal", planes_.normal, 3);
  add("surface_point", planes_.surface_point, 3);
  add("visibility", planes_.visibility, 0);
  add("object_id", planes_.object_id, 0);
  add("flags", planes_.flags, 0);
  add("cell", planes_.cell, 0);
  add("gaussian_id", planes_.gaussian_id, 0);
  publisher.publish(info, [&](flatbuffers::FlatBufferBuilder& builder, flatbuffers::Offset<wire::Header> header) {
    const auto batches = builder.CreateVector(structure_.batches.data(), structure_.batch_count);
    return wire::CreateModelPublished(
        builder, header, structure_.generation, structure_.count, planes_.capacity,
        layout().appearance == Appearance::Transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
        static_cast<std::uint8_t>(layout().sh_degree), step(), structure_.insert_epoch, batches, structure_.frozen);
  });
}

}  // namespace splatbus::trainer
