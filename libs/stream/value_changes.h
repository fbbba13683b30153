#pragma once

#include <cstddef>
#include <cstdint>

// How far the values of rows are from what a model has for them. Vectorised; the best instruction set is picked at run
// time.
namespace splatbus::stream {

/// Of rows, over the channels of an attribute, in quantizer steps.
struct ValueChanges {
  std::int32_t* largest;  ///< of |target - held|
  std::int32_t* sum;      ///< of |target - held|, of each channel kSaturation at most
  std::int32_t* drift;    ///< largest of |target - anchor|
  /// A larger change is not more urgent.
  static constexpr std::int32_t kSaturation = 64;
};

/// Adds one channel of `rows` rows: that of row i is target[column[i]]. A column of kNotHeld is in no target: what
/// comes of its row means nothing.
void add_changes(const std::int32_t* target, const std::uint32_t* column, const std::uint8_t* held,
                 const std::int32_t* anchor, std::size_t rows, const ValueChanges& to);
void add_changes(const std::int32_t* target, const std::uint32_t* column, const std::int16_t* held,
                 const std::int32_t* anchor, std::size_t rows, const ValueChanges& to);
void add_changes(const std::int32_t* target, const std::uint32_t* column, const std::int32_t* held,
                 const std::int32_t* anchor, std::size_t rows, const ValueChanges& to);

}  // namespace splatbus::stream
