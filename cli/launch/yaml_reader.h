#pragma once

#include <yaml-cpp/yaml.h>

#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "launch_file.h"

namespace splatbus::cli {

/// The nodes of a YAML file with their places, and the checks that every key needs. Functions throw LaunchError, which
/// names the place and `what` is there.
class YamlReader {
 public:
  explicit YamlReader(std::string path) : path_(std::move(path)) {}

  [[nodiscard]] SourceMark mark(const YAML::Node& node) const { return mark(node.Mark()); }
  [[nodiscard]] SourceMark mark(const YAML::Mark& at) const {
    return at.is_null() ? SourceMark{path_, 1, 1} : SourceMark{path_, at.line + 1, at.column + 1};
  }

  [[noreturn]] void refuse(const YAML::Node& node, const std::string& text) const {
    throw LaunchError(mark(node), text);
  }

  /// Calls `handle(key, key's node, value)` for each entry, after refusing what is no map and what appears twice.
  void each_entry(const YAML::Node& map, const std::string& what,
                  const std::function<void(const std::string&, const YAML::Node&, const YAML::Node&)>& handle) const;
  [[nodiscard]] std::string scalar(const YAML::Node& node, const std::string& what) const;
  [[nodiscard]] std::vector<YAML::Node> list(const YAML::Node& node, const std::string& what) const;
  [[nodiscard]] double seconds(const YAML::Node& node, const std::string& what) const;
  [[nodiscard]] int integer(const YAML::Node& node, const std::string& what, int minimum, int maximum) const;

 private:
  std::string path_;
};

}  // namespace splatbus::cli
