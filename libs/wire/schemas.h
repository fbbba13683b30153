#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

namespace splatbus::wire {

/// A root table's schema, for peers that know none of ours. Both live as long as the program.
struct TableSchema {
  std::string_view table;                ///< with its namespace: "splatbus.wire.Heartbeat"
  std::span<const std::uint8_t> binary;  ///< FlatBuffers' reflection.fbs (.bfbs)
};

/// Of what Header.schema says, "Heartbeat/1". Nullopt for tables and versions that this build does not have.
[[nodiscard]] std::optional<TableSchema> find_schema(std::string_view header_schema);

/// Of one of Foxglove's tables, "foxglove.PointCloud". Throws std::out_of_range for one that is not among
/// schemas/foxglove.
[[nodiscard]] TableSchema foxglove_schema(std::string_view table);

}  // namespace splatbus::wire
