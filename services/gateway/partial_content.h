#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

namespace splatbus::gateway {

/// What of a body a Range field asks for.
struct PartialContent {
  enum class Kind : std::uint8_t { Whole, Part, Nothing };
  Kind kind = Kind::Whole;
  std::size_t first = 0, bytes = 0;  ///< of a Part
};

/// Of "bytes=0-99", "bytes=100-" and "bytes=-100". Whole for whatever else stands there, several ranges among them, as
/// RFC 9110 allows; Nothing where the body ends before the range begins.
[[nodiscard]] PartialContent partial_content(std::string_view range, std::size_t body_bytes);

}  // namespace splatbus::gateway
