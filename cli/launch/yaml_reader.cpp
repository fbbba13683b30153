#include "yaml_reader.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>

#include "bus/nearest.h"
#include "substitution.h"

namespace splatbus::cli {

namespace {

std::string kind(const YAML::Node& node) {
  if (node.IsMap()) return "a map";
  if (node.IsSequence()) return "a list";
  if (node.IsScalar()) return "the value '" + node.Scalar() + "'";
  return "nothing";
}

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

void YamlReader::guard(const std::function<void()>& read) const {
  try {
    read();
  } catch (const LaunchError& error) {
    problems_.insert(problems_.end(), error.problems().begin(), error.problems().end());
  }
}

void YamlReader::each_entry(
    const YAML::Node& map, const std::string& what,
    const std::function<void(const std::string&, const YAML::Node&, const YAML::Node&)>& handle) const {
  if (!map.IsMap()) refuse(map, fmt::format("{} must be a map, not {}", what, kind(map)));
  std::set<std::string> seen;
  for (const auto& entry : map) {
    guard([&] {
      if (!entry.first.IsScalar()) refuse(entry.first, fmt::format("a key of {} must be a single value", what));
      const std::string& key = entry.first.Scalar();
      if (!seen.insert(key).second) refuse(entry.first, fmt::format("key '{}' appears twice in {}", key, what));
      handle(key, entry.first, entry.second);
    });
  }
}

std::string YamlReader::process_scalar(const YAML::Node& node, const std::string& what) const {
  if (!node.IsScalar()) refuse(node, fmt::format("{} must be a single value, not {}", what, kind(node)));
  try {
    return substitute(node.Scalar(), [&](const std::string& name) -> std::optional<std::string> {
      if (const auto found = variables_.find(name); found != variables_.end()) return found->second;
      if (contains(process_variables(), name)) return std::nullopt;
      std::vector<std::string> known = process_variables();
      for (const auto& [variable, value] : variables_) known.push_back(variable);
      refuse(node, fmt::format("unknown variable '${{{}}}'{}", name, bus::suggestion(name, known)));
    });
  } catch (const std::invalid_argument& error) {
    refuse(node, fmt::format("{}: {}", what, error.what()));
  }
}

std::string YamlReader::scalar(const YAML::Node& node, const std::string& what) const {
  const std::string text = process_scalar(node, what);
  return unescaped(substitute(text, [&](const std::string& name) -> std::optional<std::string> {
    refuse(node, fmt::format("'${{{}}}' is known in parameters, args and environment alone", name));
  }));
}

std::vector<YAML::Node> YamlReader::list(const YAML::Node& node, const std::string& what) const {
  if (!node.IsSequence()) refuse(node, fmt::format("{} must be a list, not {}", what, kind(node)));
  return {node.begin(), node.end()};
}

double YamlReader::number(const YAML::Node& node, const std::string& what, double minimum, double maximum) const {
  const std::string text = scalar(node, what);
  double value = 0;
  if (!YAML::convert<double>::decode(YAML::Node(text), value) || !std::isfinite(value) || value < minimum ||
      value > maximum) {
    const std::string bounds =
        maximum < 1e18 ? fmt::format("from {} to {}", minimum, maximum) : fmt::format("{} or more", minimum);
    refuse(node, fmt::format("{} must be a number, {}, not '{}'", what, bounds, text));
  }
  return value;
}

int YamlReader::integer(const YAML::Node& node, const std::string& what, int minimum, int maximum) const {
  int value = 0;
  const std::string text = scalar(node, what);
  if (!YAML::convert<int>::decode(YAML::Node(text), value) || value < minimum || value > maximum) {
    refuse(node, fmt::format("{} must be a whole number from {} to {}, not '{}'", what, minimum, maximum, text));
  }
  return value;
}

std::string YamlReader::choice(const YAML::Node& node, const std::string& what,
                               const std::vector<std::string>& choices) const {
  std::string text = scalar(node, what);
  if (contains(choices, text)) return text;
  const std::string meant = bus::nearest(text, choices);
  refuse(node, fmt::format("{} must be {} or {}, not '{}'{}", what, fmt::join(choices.begin(), choices.end() - 1, ", "),
                           choices.back(), text, meant.empty() ? "" : fmt::format("; did you mean '{}'?", meant)));
}

}  // namespace splatbus::cli
