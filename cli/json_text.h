#pragma once

#include <nlohmann/json.hpp>
#include <string>

namespace splatbus::cli {

/// JSON as text. Names and texts come from other processes: bytes that are not UTF-8 become U+FFFD instead of an
/// exception. `indent` < 0: one line.
[[nodiscard]] inline std::string json_text(const nlohmann::json& json, int indent = -1) {
  return json.dump(indent, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace splatbus::cli
