#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace splatbus::gateway::foxglove {

using NamedValues = std::vector<std::pair<std::string, std::string>>;

/// The parameters of all services as their heartbeats tell them, each under "<source>/<name>". Bounded: 64 sources of
/// 256 parameters. Not thread-safe.
class ParameterBoard {
 public:
  struct Parameter {
    std::string source, key, value;
  };

  /// Returns those, by their full names, that are new or have another value.
  NamedValues update(const std::string& source, const NamedValues& parameters);
  /// Null when there is none of that name.
  [[nodiscard]] const Parameter* find(const std::string& name) const;
  /// Those of `names` that there are; of no names, all.
  [[nodiscard]] NamedValues values(const std::vector<std::string>& names) const;
  void clear() { parameters_.clear(); }

 private:
  std::map<std::string, Parameter> parameters_;
};

/// Whether two texts are the same value to a service: numbers to a float's precision.
[[nodiscard]] bool same_value(const std::string& a, const std::string& b);

}  // namespace splatbus::gateway::foxglove
