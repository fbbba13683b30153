#pragma once

#include <yaml-cpp/yaml.h>

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "launch_file.h"

namespace splatbus::cli {

/// The nodes of a YAML file with their places, and the checks that every key needs. Functions throw LaunchError, which
/// names the place and `what` is there; guard() keeps it, and goes on.
class YamlReader {
 public:
  explicit YamlReader(std::string path) : path_(std::move(path)) {}

  [[nodiscard]] const std::string& path() const { return path_; }
  [[nodiscard]] SourceMark mark(const YAML::Node& node) const { return mark(node.Mark()); }
  [[nodiscard]] SourceMark mark(const YAML::Mark& at) const {
    return at.is_null() ? SourceMark{path_, 1, 1} : SourceMark{path_, at.line + 1, at.column + 1};
  }

  [[noreturn]] void refuse(const YAML::Node& node, const std::string& text) const {
    throw LaunchError(mark(node), text);
  }

  /// Calls `read`, and keeps what it throws as LaunchError for problems().
  void guard(const std::function<void()>& read) const;
  [[nodiscard]] std::vector<LaunchProblem>& problems() const { return problems_; }

  /// Names that `${name}` stands for, each in the form that substitute() leaves.
  [[nodiscard]] std::map<std::string, std::string>& variables() { return variables_; }

  /// Calls `handle(key, key's node, value)` for each entry, after refusing what is no map; refuses what appears twice.
  void each_entry(const YAML::Node& map, const std::string& what,
                  const std::function<void(const std::string&, const YAML::Node&, const YAML::Node&)>& handle) const;
  /// With variables() in it.
  [[nodiscard]] std::string scalar(const YAML::Node& node, const std::string& what) const;
  /// The same, where the names of process_variables() are left for later, and `$${` as it is.
  [[nodiscard]] std::string process_scalar(const YAML::Node& node, const std::string& what) const;
  [[nodiscard]] std::vector<YAML::Node> list(const YAML::Node& node, const std::string& what) const;
  /// A finite number of that range; a bound of 1e18 and more is none.
  [[nodiscard]] double number(const YAML::Node& node, const std::string& what, double minimum, double maximum) const;
  [[nodiscard]] int integer(const YAML::Node& node, const std::string& what, int minimum, int maximum) const;
  [[nodiscard]] std::string choice(const YAML::Node& node, const std::string& what,
                                   const std::vector<std::string>& choices) const;

 private:
  std::string path_;
  std::map<std::string, std::string> variables_;
  mutable std::vector<LaunchProblem> problems_;
};

}  // namespace splatbus::cli
