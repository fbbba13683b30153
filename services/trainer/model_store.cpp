#include "trainer/model_store.h"

#include <spdlog/spdlog.h>

#include <algorithm>

#include "wire/model_generated.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kSlot = 0;

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

bool ModelStore::accepts_visibility(std::uint64_t generation, std::size_t count) const {
  const bool moved = generation < structure_.removal_generation || generation > structure_.generation;
  return !moved && count <= structure_.count;
}

bool ModelStore::set_visibility(std::uint64_t generation, const float* values, Device memory, std::size_t count) {
  if (!accepts_visibility(generation, count)) return false;
  columns_->set_visibility(planes_, values, memory, count);
  return true;
}

void ModelStore::change(const std::function<void()>& work) {
  planes_slab_->begin_write(kSlot);
  work();
  structure_.generation += 1;
  commit();
  slot_generation_ = planes_slab_->end_write(kSlot);
}

void ModelStore::commit() {
  const std::uint32_t next = 1 - header_->current.load();
  header_->structure.at(next) = structure_;
  header_->current.store(next, std::memory_order_release);
}

ModelStore::Columns ModelStore::append(const InsertBatch& batch) {
  if (holds(batch.epoch, batch.batch)) return {.first = count(), .count = 0};
  const Columns added{.first = count(), .count = std::min(batch.count, room(count()))};
  if (added.count < batch.count) {
    spdlog::warn("model: {} of {} Gaussians in batch {} are left out, the model has max_gaussians ({})",
                 batch.count - added.count, batch.count, batch.batch, max_gaussians_);
  }
  reserve(added.first + added.count);
  columns_->append(planes_, batch, added.first, added.count, structure_.next_gaussian_id);
  structure_.next_gaussian_id += added.count;
  structure_.count += added.count;
  remember(structure_, batch.epoch, batch.batch);
  return added;
}

ModelStore::Columns ModelStore::duplicate(const std::vector<std::uint32_t>& columns) {
  const Columns added{.first = count(), .count = std::min(columns.size(), room(count()))};
  reserve(added.first + added.count);
  columns_->duplicate(planes_, std::span(columns).first(added.count), added.first, structure_.next_gaussian_id);
  structure_.next_gaussian_id += added.count;
  structure_.count += added.count;
  return added;
}

ColumnMoves ModelStore::remove(const std::uint8_t* dead) {
  const ColumnMoves moves = columns_->remove(planes_, count(), dead);
  if (moves.new_count == count()) return moves;
  structure_.count = moves.new_count;
  structure_.removal_generation = structure_.generation + 1;
  return moves;
}

void ModelStore::publish(const bus::Publisher& publisher) const {
  const auto stride = static_cast<std::uint32_t>(planes_.capacity);
  const std::byte* const start = planes_slab_->slot_data(kSlot);
  bus::MessageInfo info;
  const auto add = [&](const char* name, const auto* plane, std::uint32_t channels) {
    using Element = std::remove_const_t<std::remove_pointer_t<decltype(plane)>>;
    std::vector<std::uint32_t> shape{stride};
    if (channels != 0) shape.insert(shape.begin(), channels);
    const std::size_t bytes = std::size_t{stride} * std::max(1U, channels) * sizeof(Element);
    const auto offset = static_cast<std::size_t>(reinterpret_cast<const std::byte*>(plane) - start);
    info.tensors.push_back({.name = name,
                            .shape = shape,
                            .type = bus::ElementTypeOf<Element>::value,
                            .span = planes_slab_->span(kSlot, offset, bytes, slot_generation_)});
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
  publisher.publish(
      topics::kModelPublished, info,
      [&](flatbuffers::FlatBufferBuilder& builder, flatbuffers::Offset<wire::Header> header) {
        const auto batches = builder.CreateVector(structure_.batches.data(), structure_.batch_count);
        return wire::CreateModelPublished(
            builder, header, structure_.generation, structure_.count, planes_.capacity,
            layout().appearance == Appearance::Transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
            static_cast<std::uint8_t>(layout().sh_degree), step(), structure_.insert_epoch, batches);
      });
}

}  // namespace splatbus::trainer
