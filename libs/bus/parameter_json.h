#pragma once

#include <string>
#include <vector>

#include "bus/parameters.h"

namespace splatbus::bus {

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
