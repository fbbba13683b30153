#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "device/device.h"
#include "wire/common_generated.h"

namespace splatbus::bus {

/// Tensors that lie one after the other each begin at a multiple of this many bytes.
constexpr std::size_t tensor_alignment = 64;

/// `bytes`, rounded up to where the next tensor may begin.
[[nodiscard]] constexpr std::size_t aligned(std::size_t bytes) {
  return (bytes + tensor_alignment - 1) / tensor_alignment * tensor_alignment;
}

class Slab;

using wire::ElementType;

/// Bytes of one element.
[[nodiscard]] std::size_t element_bytes(ElementType type);

/// Product of `shape`, times the element's size. Throws bus::Error when it overflows or exceeds `limit_bytes`.
[[nodiscard]] std::size_t tensor_bytes(std::span<const std::uint32_t> shape, ElementType type,
                                       std::size_t limit_bytes = std::size_t{1} << 34);

/// Where the bytes of an outgoing tensor lie: a committed slot of a slab (no copy on this machine; the broker inlines
/// it for readers over tcp), or a plain host buffer that is copied into the message as its third frame.
struct OutgoingTensor {
  std::string name;
  std::vector<std::uint32_t> shape;
  ElementType type = ElementType::F32;
  wire::Span span{};                  ///< from Slab::commit(); ignored when `inline_data` is set
  const void* inline_data = nullptr;  ///< tensor_bytes(shape, type) bytes, read during publish()
};

/// A tensor as a receiver sees it: verified to lie within its slab or frame. The memory stays mapped as long as this
/// object lives, but a slab slot may be overwritten at any time: copy() reports that; whoever uses data() in place
/// calls still_valid() afterwards and throws its result away when that is false.
class TensorView {
 public:
  /// In host memory that `keep_alive` owns.
  TensorView(std::string name, std::vector<std::uint32_t> shape, ElementType type, const std::byte* data,
             std::size_t bytes, std::shared_ptr<const void> keep_alive);

  /// In a slab. Throws bus::Error when the span leaves its slot, is not what the shape needs, or is not aligned to its
  /// elements.
  TensorView(std::string name, std::vector<std::uint32_t> shape, ElementType type, std::shared_ptr<const Slab> slab,
             const wire::Span& span);

  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] std::span<const std::uint32_t> shape() const { return shape_; }
  [[nodiscard]] std::uint32_t dim(std::size_t axis) const { return shape_.at(axis); }
  [[nodiscard]] ElementType type() const { return type_; }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }
  [[nodiscard]] std::size_t elements() const { return bytes_ / element_bytes(type_); }
  [[nodiscard]] const std::byte* data() const { return data_; }  ///< a device address when memory() is Cuda
  [[nodiscard]] Device memory() const;

  /// Typed view of data(). Throws bus::Error when T does not match type(), or the memory is not the host's.
  template <class T>
  [[nodiscard]] std::span<const T> as() const;

  /// True while the slot still holds what the message announced. Always true for inline tensors.
  [[nodiscard]] bool still_valid() const;

  /// True when still_valid() of one tells for both: they lie in one slot of one slab, under one generation, or both are
  /// inline.
  [[nodiscard]] bool shares_validity(const TensorView& other) const;

  /// Copies all bytes to `destination` in host memory (bytes() of room). False when the slot was overwritten meanwhile;
  /// the destination then holds garbage.
  [[nodiscard]] bool copy(void* destination) const;

 private:
  void require_host(ElementType type) const;

  std::string name_;
  std::vector<std::uint32_t> shape_;
  ElementType type_;
  const std::byte* data_;
  std::size_t bytes_;
  std::shared_ptr<const void> keep_alive_;
  std::shared_ptr<const Slab> slab_;  // null for inline tensors
  wire::Span span_{};
};

/// The ElementType whose elements are T.
template <class T>
struct ElementTypeOf;
template <ElementType type>
struct ElementTypeIs {
  static constexpr auto value = type;
};
template <>
struct ElementTypeOf<std::uint8_t> : ElementTypeIs<ElementType::U8> {};
template <>
struct ElementTypeOf<std::uint16_t> : ElementTypeIs<ElementType::U16> {};
template <>
struct ElementTypeOf<std::uint32_t> : ElementTypeIs<ElementType::U32> {};
template <>
struct ElementTypeOf<std::uint64_t> : ElementTypeIs<ElementType::U64> {};
template <>
struct ElementTypeOf<std::int32_t> : ElementTypeIs<ElementType::I32> {};
template <>
struct ElementTypeOf<float> : ElementTypeIs<ElementType::F32> {};

template <class T>
std::span<const T> TensorView::as() const {
  require_host(ElementTypeOf<T>::value);
  return {reinterpret_cast<const T*>(data_), bytes_ / sizeof(T)};
}

}  // namespace splatbus::bus
