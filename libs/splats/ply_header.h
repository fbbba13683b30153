#pragma once

#include <cstddef>
#include <cstdint>
#include <istream>
#include <string>
#include <string_view>
#include <vector>

namespace splatbus::splats {

/// The comment by which our files say that their axes were kept.
inline constexpr std::string_view kPlyYUp = "SplatAxes: y-up";
inline constexpr std::string_view kPlyMip = "SplatRenderMode: mip";

enum class PlyType : std::uint8_t { Int8, UInt8, Int16, UInt16, Int32, UInt32, Float32, Float64 };

[[nodiscard]] std::size_t size_of(PlyType type);

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::Float32;
  std::size_t offset = 0;  ///< bytes from the start of the row
};

/// The header of a binary little-endian PLY file, as far as the element `vertex`.
struct PlyHeader {
  std::size_t vertex_count = 0;
  std::size_t vertex_bytes = 0;   ///< of one row
  std::size_t vertex_offset = 0;  ///< of the first row, bytes from the start of the file
  std::vector<PlyProperty> properties;
  bool mip =
      false;  ///< "comment SplatRenderMode: mip", as Brush writes it, or "comment antialiased 1", as Postshot does
  bool y_up = false;  ///< kPlyYUp

  /// Null when there is none of that name.
  [[nodiscard]] const PlyProperty* find(const std::string& name) const;
};

/// Leaves the stream behind the header's last line. `file_bytes` bounds what the header may claim. Throws
/// std::runtime_error that names `path` and the line.
[[nodiscard]] PlyHeader read_ply_header(std::istream& stream, const std::string& path, std::size_t file_bytes);

}  // namespace splatbus::splats
