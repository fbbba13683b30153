#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace splatbus::cli {

/// JSON as YAML in blocks, keys in their order, every text in quotes.
[[nodiscard]] std::string yaml_text(const nlohmann::ordered_json& json);

}  // namespace splatbus::cli
