#pragma once

#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "bus/subscriber.h"

namespace splatbus::cli {

/// Turns any message that wire::find_schema knows into JSON. Not thread-safe.
class SchemaJson {
 public:
  SchemaJson();
  ~SchemaJson();
  SchemaJson(const SchemaJson&) = delete;
  SchemaJson& operator=(const SchemaJson&) = delete;

  /// Fields under their schema's names. Each entry of header.tensors becomes {name, shape, type, min, max}; min and max
  /// are null when the data is gone. Throws bus::Error on an unknown schema or a buffer that does not verify.
  [[nodiscard]] nlohmann::json to_json(const bus::Message& message);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

/// JSON as text. Names and texts come from other processes: bytes that are not UTF-8 become U+FFFD instead of an
/// exception. `indent` < 0: one line.
[[nodiscard]] inline std::string json_text(const nlohmann::json& json, int indent = -1) {
  return json.dump(indent, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace splatbus::cli
