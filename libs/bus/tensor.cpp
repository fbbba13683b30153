#include "bus/tensor.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstdint>
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
                       std::size_t bytes, std::shared_ptr<const void> keep_alive)
    : name_(std::move(name)),
      shape_(std::move(shape)),
      type_(type),
      data_(data),
      bytes_(bytes),
      keep_alive_(std::move(keep_alive)) {}

TensorView::TensorView(std::string name, std::vector<std::uint32_t> shape, ElementType type,
                       std::shared_ptr<const Slab> slab, const wire::Span& span)
    : name_(std::move(name)),
      shape_(std::move(shape)),
      type_(type),
      data_(slab->data_of(span)),
      bytes_(span.bytes()),
      slab_(std::move(slab)),
      span_(span) {
  // A kernel that reads too far, or askew, takes its whole process down.
  if (const std::size_t needed = tensor_bytes(shape_, type_); needed != bytes_) {
    throw Error(fmt::format("tensor '{}' of shape [{}] needs {} bytes, its span in slab '{}' has {}", name_,
                            fmt::join(shape_, ", "), needed, slab_->name(), bytes_));
  }
  if (reinterpret_cast<std::uintptr_t>(data_) % element_bytes(type_) != 0) {
    throw Error(fmt::format("tensor '{}' begins at byte {} of slab '{}', which its elements of {} bytes cannot", name_,
                            span_.offset(), slab_->name(), element_bytes(type_)));
  }
}

Device TensorView::memory() const {
  return slab_ == nullptr ? Device::Cpu : slab_->descriptor().kind;
}

bool TensorView::still_valid() const {
  return slab_ == nullptr || slab_->holds(span_);
}

bool TensorView::shares_validity(const TensorView& other) const {
  if (slab_ == nullptr || other.slab_ == nullptr) return slab_ == other.slab_;
  return slab_->id() == other.slab_->id() && slab_->slot_of(span_) == other.slab_->slot_of(other.span_) &&
         span_.generation() == other.span_.generation();
}

bool TensorView::copy(void* destination) const {
  if (slab_ != nullptr) return slab_->copy(span_, destination);
  if (bytes_ > 0) std::memcpy(destination, data_, bytes_);
  return true;
}

void TensorView::require_host(ElementType type) const {
  if (type != type_) {
    throw Error(fmt::format("tensor '{}' holds {}, asked for as {}", name_, wire::EnumNameElementType(type_),
                            wire::EnumNameElementType(type)));
  }
  if (memory() != Device::Cpu) throw Error(fmt::format("tensor '{}' is not in host memory", name_));
}

}  // namespace splatbus::bus
