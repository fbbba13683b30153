#pragma once

#include <span>

namespace splatbus::cli {

struct EmbeddedSchema {
  const char* name;  ///< "common.fbs"
  const char* text;
};

/// The files of schemas/ as they were at build time, each after those that it includes.
[[nodiscard]] std::span<const EmbeddedSchema> embedded_schemas();

}  // namespace splatbus::cli
