#include "bus/tensor_ring.h"

#include <algorithm>
#include <utility>

#include "bus/memory.h"
#include "bus/tensor.h"

namespace splatbus::bus {

namespace {

constexpr int kCreateTimeoutMs = 10000;

}  // namespace

TensorRing::TensorRing(std::shared_ptr<Context> context, std::string role, std::size_t slots, std::size_t slot_bytes,
                       Device kind)
    : context_(std::move(context)), role_(std::move(role)), slots_(slots), slot_bytes_(slot_bytes), kind_(kind) {}

std::vector<OutgoingTensor> TensorRing::write(std::span<const TensorSource> sources) {
  std::size_t needed = 0;
  for (const TensorSource& source : sources) needed += aligned(tensor_bytes(source.shape, source.type));
  if (!slab_ || slab_->slot_bytes() < needed) {
    // Twice the room, so that growing messages seldom make a new slab.
    slot_bytes_ = std::max({slot_bytes_, slab_ ? 2 * needed : needed, tensor_alignment});
    slab_ = context_->create_slab(role_, slots_, slot_bytes_, kCreateTimeoutMs, kind_);
  }
  const std::size_t slot = slab_->next_slot();
  std::size_t offset = 0;
  for (const TensorSource& source : sources) {
    const std::size_t bytes = tensor_bytes(source.shape, source.type);
    copy_memory(slab_->slot_data(slot) + offset, kind_, source.data, source.memory, bytes);
    offset += aligned(bytes);
  }
  finish_copies();
  const std::uint64_t generation = slab_->end_write(slot);

  std::vector<OutgoingTensor> tensors;
  offset = 0;
  for (const TensorSource& source : sources) {
    const std::size_t bytes = tensor_bytes(source.shape, source.type);
    tensors.push_back({.name = source.name,
                       .shape = source.shape,
                       .type = source.type,
                       .span = slab_->span(slot, offset, bytes, generation)});
    offset += aligned(bytes);
  }
  return tensors;
}

}  // namespace splatbus::bus
