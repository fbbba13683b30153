#include "parameter_edit.h"

#include <fmt/format.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cstddef>
#include <optional>
#include <vector>

#include "launch_file.h"
#include "substitution.h"

namespace splatbus::cli {

namespace {

/// As YAML has it: plain where that reads back as the same text, else in double quotes.
std::string yaml_scalar(const std::string& text) {
  std::string value = escaped(text);
  const bool plain = !value.empty() &&
                     value.find_first_not_of(
                         "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                         "0123456789_./+-") == std::string::npos &&
                     value.front() != '-' && value.front() != '.' && value != "null" && value != "~";
  bool number = false;
  double parsed = 0;
  if (!value.empty() && value.front() == '-') number = YAML::convert<double>::decode(YAML::Node(value), parsed);
  if (plain || number) return value;
  YAML::Emitter emitter;
  emitter << YAML::DoubleQuoted << value;
  return emitter.c_str();
}

struct Edit {
  std::size_t begin, end;  // bytes that go
  std::string text;        // what comes there
};

std::size_t begin_of(const YAML::Node& node) {
  return static_cast<std::size_t>(node.Mark().pos);
}

std::size_t line_end(const std::string& text, std::size_t at) {
  return std::min(text.find('\n', at), text.size());
}

/// Where a scalar of one line ends. Nullopt for one that cannot be told: of several lines, with a tag or an anchor.
std::optional<std::size_t> end_of_scalar(const std::string& text, const YAML::Node& node) {
  const std::size_t begin = begin_of(node);
  const std::size_t line = line_end(text, begin);
  const char quote = begin < text.size() ? text[begin] : '\0';
  std::size_t end = 0;
  if (quote == '"' || quote == '\'') {
    for (end = begin + 1; end < line && text[end] != quote; ++end) {
      if (quote == '"' && text[end] == '\\') ++end;
      // Two quotes stand for one.
      if (quote == '\'' && text.compare(end + 1, 2, "''") == 0) end += 2;
    }
    if (end >= line) return {};
    ++end;
  } else {
    end = begin + node.Scalar().size();
    if (text.compare(begin, node.Scalar().size(), node.Scalar()) != 0) return {};
  }
  // The text that is there has to be the value that is known, or something else is meant by it.
  try {
    const YAML::Node again = YAML::Load(text.substr(begin, end - begin));
    if (!again.IsScalar() || again.Scalar() != node.Scalar()) return {};
  } catch (const YAML::Exception&) {
    return {};
  }
  return end;
}

[[noreturn]] void refuse(const YAML::Node& node, const std::string& path, const std::string& text) {
  throw LaunchError({path, node.Mark().line + 1, node.Mark().column + 1}, text);
}

YAML::Node find_service(const YAML::Node& root, const std::string& path, const std::string& name) {
  if (root.IsMap() && root["services"] && root["services"].IsSequence()) {
    for (const auto& service : root["services"]) {
      if (service.IsMap() && service["name"] && service["name"].IsScalar() && service["name"].Scalar() == name) {
        return service;
      }
    }
  }
  throw LaunchError({path, 0, 0}, fmt::format("has no service '{}' of its own", name));
}

bool is_flow(const std::string& text, const YAML::Node& map) {
  return begin_of(map) < text.size() && text[begin_of(map)] == '{';
}

/// New entries of a block map, below its last line: what is there may be a value of its own several lines long.
Edit below(const std::string& text, const YAML::Node& map, const std::vector<std::string>& lines) {
  YAML::Node last_key, last;
  for (const auto& entry : map) {
    if (!last_key || entry.first.Mark().pos > last_key.Mark().pos) {
      last_key.reset(entry.first);
      last.reset(entry.second);
    }
  }
  while (last.IsMap() || last.IsSequence()) {
    if (last.size() == 0 || is_flow(text, last) || text[begin_of(last)] == '[') break;
    YAML::Node inner;
    if (last.IsMap()) {
      for (const auto& entry : last) {
        if (!inner || entry.second.Mark().pos > inner.Mark().pos) inner.reset(entry.second);
      }
    } else {
      inner.reset(last[last.size() - 1]);
    }
    last.reset(inner);
  }
  std::size_t at = std::max(begin_of(last_key), begin_of(last));
  if (last.IsScalar()) at += last.Scalar().size();
  if (!last.IsScalar()) {  // a flow collection: up to its closing bracket
    int depth = 0;
    for (; at < text.size(); ++at) {
      if (text[at] == '{' || text[at] == '[') ++depth;
      if ((text[at] == '}' || text[at] == ']') && --depth == 0) break;
    }
  }
  at = line_end(text, std::min(at, text.size()));
  const std::string indent(static_cast<std::size_t>(map.begin()->first.Mark().column), ' ');
  std::string added;
  for (const std::string& line : lines) added += fmt::format("\n{}{}", indent, line);
  return {at, at, added};
}

std::string flow_entries(const std::map<std::string, std::string>& values) {
  std::string text;
  for (const auto& [key, value] : values) {
    if (!text.empty()) text += ", ";
    text += fmt::format("{}: {}", key, yaml_scalar(value));
  }
  return text;
}

std::vector<std::string> block_entries(const std::map<std::string, std::string>& values, const std::string& indent) {
  std::vector<std::string> lines;
  lines.reserve(values.size());
  for (const auto& [key, value] : values) lines.push_back(fmt::format("{}{}: {}", indent, key, yaml_scalar(value)));
  return lines;
}

Edit add_to_flow(const std::string& text, const YAML::Node& map, const std::string& entries) {
  const std::size_t at = begin_of(map) + 1;
  const std::size_t next = text.find_first_not_of(" \n", at);
  const bool empty = next != std::string::npos && text[next] == '}';
  return {at, at, empty ? entries : entries + ", "};
}

bool same(const YAML::Node& a, const YAML::Node& b) {
  if (a.Type() != b.Type() || a.size() != b.size()) return false;
  if (a.IsScalar()) return a.Scalar() == b.Scalar();
  if (a.IsSequence()) {
    for (std::size_t i = 0; i < a.size(); ++i) {
      if (!same(a[i], b[i])) return false;
    }
  }
  if (!a.IsMap()) return true;
  for (const auto& entry : a) {
    const bool found = std::any_of(b.begin(), b.end(), [&](const auto& other) {
      return same(entry.first, other.first) && same(entry.second, other.second);
    });
    if (!found) return false;
  }
  return true;
}

bool reads_as(const std::string& yaml, const YAML::Node& wanted) {
  try {
    return same(YAML::Load(yaml), wanted);
  } catch (const YAML::Exception&) {
    return false;
  }
}

}  // namespace

std::string with_parameters(const std::string& yaml, const std::string& path, const std::string& service,
                            const std::map<std::string, std::string>& changes) {
  if (changes.empty()) return yaml;
  YAML::Node root;
  try {
    root = YAML::Load(yaml);
  } catch (const YAML::Exception& error) {
    throw LaunchError({path, error.mark.line + 1, error.mark.column + 1}, "not YAML: " + error.msg);
  }
  const YAML::Node entry = find_service(root, path, service);
  const YAML::Node parameters = entry["parameters"];
  std::map<std::string, std::string> added = changes;
  std::vector<Edit> edits;
  if (parameters && parameters.IsMap()) {
    for (const auto& parameter : parameters) {
      const auto change = added.find(parameter.first.Scalar());
      if (change == added.end()) continue;
      const auto end = parameter.second.IsScalar() ? end_of_scalar(yaml, parameter.second) : std::nullopt;
      if (!end) {
        refuse(parameter.second, path, fmt::format("change '{}' by hand: its value is not on one line", change->first));
      }
      edits.push_back({begin_of(parameter.second), *end, yaml_scalar(change->second)});
      added.erase(change);
    }
  }
  if (!added.empty()) {
    if (parameters && parameters.IsMap() && parameters.size() > 0 && !is_flow(yaml, parameters)) {
      edits.push_back(below(yaml, parameters, block_entries(added, "")));
    } else if (parameters && parameters.IsMap() && is_flow(yaml, parameters)) {
      edits.push_back(add_to_flow(yaml, parameters, flow_entries(added)));
    } else if (parameters) {
      refuse(parameters, path, "change these parameters by hand: they are not a map of names to values");
    } else if (is_flow(yaml, entry)) {
      const YAML::Node name = entry["name"];
      const auto end = end_of_scalar(yaml, name);
      if (!end) refuse(name, path, "add the parameters by hand");
      edits.push_back({*end, *end, fmt::format(", parameters: {{{}}}", flow_entries(added))});
    } else {
      std::vector<std::string> lines = block_entries(added, "  ");
      lines.insert(lines.begin(), "parameters:");
      edits.push_back(below(yaml, entry, lines));
    }
  }
  std::sort(edits.begin(), edits.end(), [](const Edit& a, const Edit& b) { return a.begin > b.begin; });
  std::string result = yaml;
  for (const Edit& edit : edits) result.replace(edit.begin, edit.end - edit.begin, edit.text);
  // What the file says now is what was wanted, and nothing else, or it is not written.
  YAML::Node wanted = YAML::Load(yaml);
  YAML::Node wanted_parameters = find_service(wanted, path, service)["parameters"];
  for (const auto& [key, value] : changes) wanted_parameters[key] = escaped(value);
  if (!reads_as(result, wanted)) {
    refuse(entry, path,
           fmt::format("change '{}' by hand: the layout of this service is not understood", changes.begin()->first));
  }
  return result;
}

}  // namespace splatbus::cli
