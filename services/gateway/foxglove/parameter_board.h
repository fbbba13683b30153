#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "gateway/foxglove/protocol.h"

namespace splatbus::gateway::foxglove {

using NamedValues = std::vector<std::pair<std::string, std::string>>;

/// The parameters of all services as their heartbeats tell them, each under "<source>/<name>". Bounded: 64 sources of
/// 256 parameters. Not thread-safe.
class ParameterBoard {
 public:
  struct Parameter {
    std::string source, key, value;
    wire::ValueType type{};
  };

  /// Returns those, by their full names, that are new, have another value, or are no longer there.
  NamedParameters update(const std::string& source, const NamedParameters& parameters, std::int64_t now_ns);
  /// By source, whether it is alive, as the broker lists them. Returns what is no longer there: the parameters of who
  /// has ended, or is neither listed nor heard. A broker that has just started lists those first that it hears first.
  NamedParameters keep(const std::map<std::string, bool>& sources, std::int64_t now_ns);
  /// Whether all that keep() has named alive have been heard at some time.
  [[nodiscard]] bool complete() const { return complete_; }

  /// Null when there is none of that name.
  [[nodiscard]] const Parameter* find(const std::string& name) const;
  /// Those of `names` that there are; of no names, all.
  [[nodiscard]] NamedParameters values(const std::vector<std::string>& names) const;
  void clear() { *this = ParameterBoard(); }

 private:
  template <class Condition>
  NamedParameters take_off(Condition condition);
  void look_whether_complete();

  std::map<std::string, Parameter> parameters_;
  std::map<std::string, std::int64_t> heard_ns_;  ///< by source
  std::set<std::string> awaited_;                 ///< alive, and not heard yet
  bool listed_ = false, complete_ = false;
};

/// Whether two texts are the same value to a service: numbers to a float's precision.
[[nodiscard]] bool same_value(const std::string& a, const std::string& b);

}  // namespace splatbus::gateway::foxglove
