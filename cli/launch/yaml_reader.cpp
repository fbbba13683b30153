#include "yaml_reader.h"

#include <fmt/format.h>

#include <cmath>
#include <set>

namespace splatbus::cli {

namespace {

std::string kind(const YAML::Node& node) {
  if (node.IsMap()) return "a map";
  if (node.IsSequence()) return "a list";
  if (node.IsScalar()) return "the value '" + node.Scalar() + "'";
  return "nothing";
}

}  // namespace

void YamlReader::each_entry(
    const YAML::Node& map, const std::string& what,
    const std::function<void(const std::string&, const YAML::Node&, const YAML::Node&)>& handle) const {
  if (!map.IsMap()) refuse(map, fmt::format("{} must be a map, not {}", what, kind(map)));
  std::set<std::string> seen;
  for (const auto& entry : map) {
    const std::string key = scalar(entry.first, "a key of " + what);
    if (!seen.insert(key).second) refuse(entry.first, fmt::format("key '{}' appears twice in {}", key, what));
    handle(key, entry.first, entry.second);
  }
}

std::string YamlReader::scalar(const YAML::Node& node, const std::string& what) const {
  if (!node.IsScalar()) refuse(node, fmt::format("{} must be a single value, not {}", what, kind(node)));
  return node.Scalar();
}

std::vector<YAML::Node> YamlReader::list(const YAML::Node& node, const std::string& what) const {
  if (!node.IsSequence()) refuse(node, fmt::format("{} must be a list, not {}", what, kind(node)));
  return {node.begin(), node.end()};
}

double YamlReader::seconds(const YAML::Node& node, const std::string& what) const {
  double value = 0;
  const std::string text = scalar(node, what);
  if (!YAML::convert<double>::decode(node, value) || !std::isfinite(value) || value < 0) {
    refuse(node, fmt::format("{} must be seconds, 0 or more, not '{}'", what, text));
  }
  return value;
}

int YamlReader::integer(const YAML::Node& node, const std::string& what, int minimum, int maximum) const {
  int value = 0;
  const std::string text = scalar(node, what);
  if (!YAML::convert<int>::decode(node, value) || value < minimum || value > maximum) {
    refuse(node, fmt::format("{} must be a whole number from {} to {}, not '{}'", what, minimum, maximum, text));
  }
  return value;
}

}  // namespace splatbus::cli
