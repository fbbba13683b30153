#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "bus/parameters.h"

namespace splatbus::wire {
enum class ValueType : std::uint8_t;
}

namespace splatbus::bus {

/// As heartbeats say it.
[[nodiscard]] wire::ValueType value_type(const ParameterSpec& spec);
/// What a heartbeat says of a parameter, as the type that it names; a text where that is none, or not what the text is.
[[nodiscard]] ParameterValue typed_value(const std::string& text, wire::ValueType type);

/// A parameter as a program tells others of it.
struct ParameterDescription {
  std::string name, type, bounds;  ///< type_name(), bounds_text()
  std::string default_value, value, text;
  bool at_start = false;  ///< fixed while the service runs
};

/// A setting that a program refuses, and why.
struct ParameterProblem {
  std::string parameter;  ///< empty when it is about none in particular
  std::string text;
};

/// What `PROGRAM --parameters --json` prints, on one line.
struct ParameterReport {
  std::vector<ParameterDescription> parameters;
  std::vector<ParameterProblem> problems;
};

[[nodiscard]] std::vector<ParameterDescription> describe(const Parameters& parameters);
[[nodiscard]] std::string to_json(const ParameterReport& report);
/// Throws Error when the text is no such report.
[[nodiscard]] ParameterReport parse_parameter_report(const std::string& json);

}  // namespace splatbus::bus
