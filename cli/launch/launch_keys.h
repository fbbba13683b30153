#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include "bus/nearest.h"
#include "yaml_reader.h"

namespace splatbus::cli {

/// What a key's value looks like: for the JSON schema, in the words that a reader of the file needs.
enum class Shape { Text, Number, Integer, Choice, TextList, TextMap, Object, ObjectList, ObjectMap };

/// A key of a launch file, as reader and schema have it.
struct KeyRule {
  std::string name;
  Shape shape = Shape::Text;
  std::string text;  ///< what it is, for whoever hovers over it
  double minimum = 0;
  double maximum = 1e18;  ///< numbers; from 1e18 on there is no bound
  std::vector<std::string> choices = {};
  std::vector<KeyRule> keys = {};  ///< of objects; with Choice: a map of these is good too, with Text likewise
  bool required = false;
};

/// A key and what becomes of its value. `read` gets "restart of service 'x'" as the name of the value.
template <class T>
struct Key {
  KeyRule rule;
  std::function<void(T& target, const YamlReader& reader, const YAML::Node& value, const std::string& what)> read;
};

/// Reads a map by its table of keys, `of` such as "of service 'bus'"; unknown ones are refused with the nearest known.
template <class T>
void read_keys(const YamlReader& reader, const YAML::Node& map, const std::vector<Key<T>>& table, T& target,
               const std::string& map_name, const std::string& of) {
  reader.each_entry(map, map_name, [&](const std::string& name, const YAML::Node& key_node, const YAML::Node& value) {
    const auto key = std::find_if(table.begin(), table.end(), [&](const auto& k) { return k.rule.name == name; });
    if (key == table.end()) {
      std::vector<std::string> known;
      known.reserve(table.size());
      for (const auto& k : table) known.push_back(k.rule.name);
      reader.refuse(key_node, fmt::format("unknown key '{}'{}{}", name, of, bus::suggestion(name, known)));
    }
    key->read(target, reader, value, name + of);
  });
}

template <class T>
std::vector<KeyRule> rules_of(const std::vector<Key<T>>& table) {
  std::vector<KeyRule> rules;
  rules.reserve(table.size());
  for (const auto& key : table) rules.push_back(key.rule);
  return rules;
}

/// An entry of `include:`.
struct Include {
  Marked<std::string> file;
  std::map<std::string, Marked<std::string>> arguments;
};

/// An entry of `arguments:`.
struct ArgumentRule {
  std::string type;  ///< empty: as the default looks
  std::optional<Marked<std::string>> default_value;
  std::optional<double> minimum, maximum;
  std::vector<std::string> choices;
  std::string text;
};

[[nodiscard]] const std::vector<Key<LaunchService>>& service_keys();
[[nodiscard]] const std::vector<Key<Include>>& include_keys();
[[nodiscard]] const std::vector<Key<ArgumentRule>>& argument_keys();

/// Keys of the file itself: read in this order, whatever theirs is in the file.
[[nodiscard]] const std::vector<KeyRule>& file_keys();

/// Refuses dependencies on nobody, and cycles, naming the way round. Throws LaunchError.
void check_order(const LaunchFile& file);
/// The file's world, as a parameter of each trainer that has none of its own. Throws LaunchError where there is none.
void give_world(LaunchFile& file);

}  // namespace splatbus::cli
