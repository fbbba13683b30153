#pragma once

#include <cstdint>

#include "stream/planes/tables.h"

// What a blob of PageCodec::Planes says of a plane: docs/page-codec.md. All of it is integer arithmetic, the same on
// every machine.
namespace splatbus::stream::planes {

inline constexpr std::uint8_t kFormat = 3;
enum Flags : std::uint8_t { kHasIds = 1, kOneObject = 2, kOwnOrder = 4 };

/// How a plane is predicted, and how its residuals are distributed. Two bytes, then `offset` as a zigzag varint.
enum class Predictor : std::uint8_t {
  Constant = 0,  ///< all values are the offset; nothing follows
  Offset = 1,    ///< the offset, and so much more a class
  Lane = 2,      ///< the lane before
  Channel = 3,   ///< the channel before; of a third colour the mean of both before
  Both = 4,      ///< the lane before and how the channel before has changed from there
};
inline constexpr int kPredictors = 5;

struct PlaneModel {
  Predictor predictor{};
  Shape shape{};
  int slope = 4;               ///< quarter octaves of spread that a shift by one takes away, 1 to 4
  int spread = 0;              ///< at a shift of 0
  std::int32_t per_class = 0;  ///< eighths that the offset grows by a class
  std::int32_t offset = 0;
};

}  // namespace splatbus::stream::planes
