#include "bus/tensor.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <atomic>
#include <cstring>
#include <utility>

#include "bus/error.h"
#include "bus/slab.h"

namespace splatbus::bus {

std::size_t element_bytes(ElementType type) {
  switch (type) {
    case ElementType::U8:
      return 1;
    case ElementType::U16:
    case ElementType::F16:
      return 2;
    case ElementType::U32:
    case ElementType::I32:
    case ElementType::F32:
      return 4;
    case ElementType::U64:
      return 8;
  }
  throw Error(fmt::format("element type {} does not exist", static_cast<int>(type)));
}

std::size_t tensor_bytes(std::span<const std::uint32_t> shape, ElementType type, std::size_t limit_bytes) {
  std::size_t bytes = element_bytes(type);
  for (const std::uint32_t dim : shape) {
    if (__builtin_mul_overflow(bytes, std::size_t{dim}, &bytes)) {
      throw Error(fmt::format("tensor of shape [{}] overflows", fmt::join(shape, ", ")));
    }
  }
  if (bytes > limit_bytes) {
    throw Error(
        fmt::format("tensor of shape [{}] has {} bytes, the limit is {}", fmt::join(shape, ", "), bytes, limit_bytes));
  }
  return bytes;
}

TensorView::TensorView(std::string name, std::vector<std::uint32_t> shape, ElementType type, const std::byte* data,
                       std::size_t bytes, std::shared_ptr<const void> keep_alive, const void* slot_sequence,
                       std::uint64_t generation)
    : name_(std::move(name)),
      shape_(std::move(shape)),
      type_(type),
      data_(data),
      bytes_(bytes),
      keep_alive_(std::move(keep_alive)),
      slot_sequence_(slot_sequence),
      generation_(generation) {}

bool TensorView::still_valid() const {
  if (slot_sequence_ == nullptr) return true;
  // The fence keeps the reads of the data that came before from sinking below the check (Boehm 2012, seqlock readers).
  std::atomic_thread_fence(std::memory_order_acquire);
  return static_cast<const std::atomic<std::uint64_t>*>(slot_sequence_)->load(std::memory_order_relaxed) == generation_;
}

bool TensorView::copy(void* destination) const {
  if (!still_valid()) return false;
  if (bytes_ > 0) std::memcpy(destination, data_, bytes_);
  return still_valid();
}

void TensorView::require_type(ElementType type) const {
  if (type != type_) {
    throw Error(fmt::format("tensor '{}' holds {}, asked for as {}", name_, wire::EnumNameElementType(type_),
                            wire::EnumNameElementType(type)));
  }
}

}  // namespace splatbus::bus
