#pragma once

#include <memory>
#include <nlohmann/json.hpp>

#include "bus/subscriber.h"

namespace splatbus::cli {

/// Turns any message of the schemas that this program was built with into JSON. Not thread-safe.
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

}  // namespace splatbus::cli
