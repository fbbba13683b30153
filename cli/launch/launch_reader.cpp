#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>

#include "bus/parameters.h"
#include "launch_file.h"
#include "launch_keys.h"
#include "substitution.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
constexpr std::size_t kMaxFileBytes = 1 << 20;

bool is_name(const std::string& name) {
  return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](unsigned char c) {
    return std::isalnum(c) != 0 || c == '-' || c == '_';
  });
}

/// What is read of one launch over all its files.
struct Reading {
  LaunchFile file;
  const LaunchArguments& given;
  std::set<std::string> declared;  ///< arguments of any file
  std::vector<std::string> path;   ///< files from the first to the one that is being read
  std::vector<LaunchProblem> problems;
};

using Arguments = std::map<std::string, Marked<std::string>>;

std::string read_text(const std::string& path) {
  // Something else than a file, a terminal or a pipe say, may never end.
  if (fs::is_directory(path)) return {};
  std::ifstream stream(path);
  std::string text(kMaxFileBytes + 1, '\0');
  stream.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(std::max<std::streamsize>(stream.gcount(), 0)));
  return text;
}

/// The type of an argument that names none.
std::string type_of(const YAML::Node& value) {
  bool boolean = false;
  std::int64_t integer = 0;
  double number = 0;
  if (value.Tag() == "!") return "text";  // quoted
  if (YAML::convert<std::int64_t>::decode(value, integer)) return "integer";
  if (YAML::convert<double>::decode(value, number)) return "number";
  return YAML::convert<bool>::decode(value, boolean) ? "boolean" : "text";
}

bus::ParameterSpec spec_of(const std::string& name, const ArgumentRule& rule) {
  bus::ParameterSpec spec{.name = name, .default_value = std::string(), .description = rule.text};
  if (rule.type == "integer") spec.default_value = std::int64_t{0};
  if (rule.type == "number") spec.default_value = 0.0;
  if (rule.type == "boolean") spec.default_value = false;
  if (rule.minimum) spec.range.minimum = *rule.minimum;
  if (rule.maximum) spec.range.maximum = *rule.maximum;
  spec.choices = rule.choices;
  return spec;
}

class FileReader {
 public:
  FileReader(Reading& reading, std::string path) : reading_(reading), reader_(std::move(path)) {}

  void read(const std::string& yaml, const Arguments& arguments) {
    reader_.guard([&] { read_keys_of(yaml, arguments); });
    auto& problems = reader_.problems();
    std::move(problems.begin(), problems.end(), std::back_inserter(reading_.problems));
  }

 private:
  void read_keys_of(const std::string& yaml, const Arguments& arguments) {
    YAML::Node root;
    try {
      root = YAML::Load(yaml);
    } catch (const YAML::Exception& error) {
      throw LaunchError(reader_.mark(error.mark), "not YAML: " + error.msg);
    }
    std::map<std::string, YAML::Node> values;
    reader_.each_entry(root, "a launch file", [&](const std::string& name, const auto& key, const auto& value) {
      std::vector<std::string> known;
      for (const KeyRule& rule : file_keys()) known.push_back(rule.name);
      if (std::find(known.begin(), known.end(), name) == known.end()) {
        reader_.refuse(key, fmt::format("unknown key '{}'{}", name, bus::suggestion(name, known)));
      }
      values.emplace(name, value);
    });
    const auto read = [&](const char* name, const std::function<void(const YAML::Node&)>& take) {
      if (const auto found = values.find(name); found != values.end()) reader_.guard([&] { take(found->second); });
    };
    read("arguments", [&](const auto& value) { read_arguments(value, arguments); });
    for (const auto& [name, value] : arguments) {
      reader_.guard([&, &argument = name, &text = value] {
        if (declared_.contains(argument)) return;
        throw LaunchError(text.mark, fmt::format("{} has no argument '{}'{}", reader_.path(), argument,
                                                 bus::suggestion(argument, {declared_.begin(), declared_.end()})));
      });
    }
    read("variables", [&](const auto& value) { read_variables(value); });
    first_service_ = reading_.file.services.size();
    read("include", [&](const auto& value) { read_includes(value); });
    own_service_ = reading_.file.services.size();
    LaunchFile& file = reading_.file;
    read("bus", [&](const auto& v) { file.bus = {reader_.scalar(v, "bus"), reader_.mark(v)}; });
    read("backend", [&](const auto& v) {
      file.backend = {reader_.choice(v, "backend", {"cpu", "cuda", "auto"}), reader_.mark(v)};
    });
    read("world", [&](const auto& v) {
      file.world = {fs::absolute(beside(reader_.scalar(v, "world"))).lexically_normal().string(), reader_.mark(v)};
    });
    read("services", [&](const auto& value) {
      const auto entries = reader_.list(value, "services");
      if (entries.empty()) reader_.refuse(value, "services is empty");
      for (const auto& entry : entries) reader_.guard([&] { read_service(entry); });
    });
    if (!values.contains("services") && !values.contains("include")) {
      reader_.refuse(root, "a launch file needs the key services, or include");
    }
  }

  [[nodiscard]] fs::path beside(const std::string& path) const {
    return fs::path(path).is_absolute() ? fs::path(path) : fs::path(reader_.path()).parent_path() / path;
  }

  /// The name of an argument or a variable, not yet that of another.
  void check_new_name(const std::string& name, const YAML::Node& key) {
    if (!is_name(name)) reader_.refuse(key, fmt::format("name '{}' may have only letters, digits, '-' and '_'", name));
    const auto& taken = process_variables();
    if (reader_.variables().contains(name) || std::find(taken.begin(), taken.end(), name) != taken.end()) {
      reader_.refuse(key, fmt::format("'${{{}}}' stands for something else already", name));
    }
  }

  void read_arguments(const YAML::Node& map, const Arguments& arguments) {
    reader_.each_entry(map, "arguments", [&](const std::string& name, const YAML::Node& key, const YAML::Node& value) {
      check_new_name(name, key);
      declared_.insert(name);
      reading_.declared.insert(name);
      ArgumentRule rule;
      const std::string of = fmt::format(" of argument '{}'", name);
      const std::size_t before = reader_.problems().size();
      if (value.IsMap()) {
        read_keys(reader_, value, argument_keys(), rule, fmt::format("argument '{}'", name), of);
      } else {
        rule.default_value = {reader_.scalar(value, "default" + of), reader_.mark(value)};
      }
      if (rule.type.empty() && rule.default_value) rule.type = type_of(value.IsMap() ? value["default"] : value);
      // Known from here on even where its value is wrong, which is said once.
      reader_.variables()[name] = "0";
      if (reader_.problems().size() > before) return;
      const Marked<std::string> chosen = choose(name, rule, key, arguments);
      const std::string problem = bus::problem_of(spec_of(name, rule), chosen.value);
      if (!problem.empty()) throw LaunchError(chosen.mark, fmt::format("argument '{}' {}", name, problem));
      reader_.variables()[name] = escaped(chosen.value);
    });
  }

  [[nodiscard]] Marked<std::string> choose(const std::string& name, const ArgumentRule& rule, const YAML::Node& key,
                                           const Arguments& arguments) const {
    if (const auto fixed = arguments.find(name); fixed != arguments.end()) return fixed->second;
    if (const auto given = reading_.given.find(name); given != reading_.given.end()) {
      return {given->second, {fmt::format("{}={}", name, given->second), 0, 0}};
    }
    if (rule.default_value) return *rule.default_value;
    reader_.refuse(key, fmt::format("argument '{0}' needs a value: launch {1} {0}=VALUE", name,
                                    reading_.path.empty() ? reader_.path() : reading_.path.front()));
  }

  void read_variables(const YAML::Node& map) {
    reader_.each_entry(map, "variables", [&](const std::string& name, const YAML::Node& key, const YAML::Node& value) {
      check_new_name(name, key);
      reader_.variables()[name] = "";
      reader_.variables()[name] = reader_.process_scalar(value, fmt::format("variable '{}'", name));
    });
  }

  void read_includes(const YAML::Node& list) {
    for (const auto& entry : reader_.list(list, "include")) {
      reader_.guard([&] {
        Include include;
        if (entry.IsMap()) {
          read_keys(reader_, entry, include_keys(), include, "an entry of include", " of an entry of include");
          if (!entry["file"]) reader_.refuse(entry, "an entry of include has no file");
        } else {
          include.file = {reader_.scalar(entry, "an entry of include"), reader_.mark(entry)};
        }
        read_include(include);
      });
    }
  }

  void read_include(const Include& include) {
    const std::string path = beside(include.file.value).lexically_normal().string();
    const std::string canonical = fs::weakly_canonical(path).string();
    auto& stack = reading_.path;
    if (const auto found = std::find(stack.begin(), stack.end(), canonical); found != stack.end()) {
      throw LaunchError(include.file.mark,
                        fmt::format("circular include: {} → {}", fmt::join(found, stack.end(), " → "), canonical));
    }
    if (!fs::is_regular_file(path)) throw LaunchError(include.file.mark, fmt::format("'{}' cannot be read", path));
    const std::string yaml = read_text(path);
    if (yaml.size() > kMaxFileBytes) throw LaunchError(include.file.mark, fmt::format("'{}' exceeds 1 MiB", path));
    reading_.file.files.push_back(path);
    stack.push_back(canonical);
    FileReader(reading_, path).read(yaml, include.arguments);
    stack.pop_back();
  }

  void read_service(const YAML::Node& node) {
    if (!node.IsMap()) reader_.refuse(node, "each entry of services must be a map with a name");
    const YAML::Node name = node["name"];
    if (!name) reader_.refuse(node, "a service has no name");
    LaunchService service;
    service.name = reader_.scalar(name, "name");
    service.mark = reader_.mark(name);
    if (!is_name(service.name)) {
      reader_.refuse(name, fmt::format("service name '{}' may have only letters, digits, '-' and '_'", service.name));
    }
    if (const YAML::Node own = node["bus"]) {
      reader_.refuse(own,
                     "all services of a launch file share one bus: set the file's 'bus', or launch a file of its own");
    }
    service.program = {"splatbus-" + service.name, service.mark};
    auto& services = reading_.file.services;
    const auto same = std::find_if(services.begin(), services.end(),
                                   [&](const LaunchService& other) { return other.name == service.name; });
    const auto index = same - services.begin();
    const bool included = same != services.end() && index >= static_cast<std::ptrdiff_t>(first_service_) &&
                          index < static_cast<std::ptrdiff_t>(own_service_) && changed_.insert(service.name).second;
    if (same != services.end() && !included) {
      reader_.refuse(name, fmt::format("service name '{}' is taken, first at {}", service.name, same->mark.text()));
    }
    if (included) service = *same;
    const std::string what = fmt::format("service '{}'", service.name);
    reader_.guard([&] { read_keys(reader_, node, service_keys(), service, what, fmt::format(" of {}", what)); });
    if (included) {
      *same = std::move(service);
    } else {
      services.push_back(std::move(service));
    }
  }

  Reading& reading_;
  YamlReader reader_;
  std::set<std::string> declared_;                   // arguments of this file
  std::set<std::string> changed_;                    // services of included files that this one has spoken of
  std::size_t first_service_ = 0, own_service_ = 0;  // where those of its includes begin and end
};

LaunchFile finish(Reading reading) {
  for (const auto& [name, value] : reading.given) {
    if (reading.declared.contains(name)) continue;
    const std::vector<std::string> known(reading.declared.begin(), reading.declared.end());
    LaunchProblem problem;
    problem.mark.file = fmt::format("{}={}", name, value);
    problem.text = fmt::format("{} has no argument '{}'{}", reading.file.path, name, bus::suggestion(name, known));
    reading.problems.push_back(std::move(problem));
  }
  if (!reading.problems.empty()) throw LaunchError(std::move(reading.problems));
  check_order(reading.file);
  give_world(reading.file);
  return std::move(reading.file);
}

}  // namespace

LaunchArguments parse_arguments(const std::vector<std::string>& assignments) {
  LaunchArguments arguments;
  for (const std::string& assignment : assignments) {
    const std::size_t equals = assignment.find('=');
    const SourceMark mark{assignment, 0, 0};
    if (equals == std::string::npos || equals == 0)
      throw LaunchError(mark, "expected name=value, an argument of the file");
    if (!arguments.emplace(assignment.substr(0, equals), assignment.substr(equals + 1)).second) {
      throw LaunchError(mark, "was given twice");
    }
  }
  return arguments;
}

LaunchFile read_launch_file(const std::string& path, const LaunchArguments& arguments) {
  const std::string yaml = read_text(path);
  if (yaml.empty()) throw LaunchError({path, 0, 0}, "cannot be read, or is empty");
  if (yaml.size() > kMaxFileBytes) throw LaunchError({path, 0, 0}, "exceeds 1 MiB");
  return parse_launch_file(yaml, path, arguments);
}

LaunchFile parse_launch_file(const std::string& yaml, const std::string& path, const LaunchArguments& arguments) {
  Reading reading{.file = {}, .given = arguments, .declared = {}, .path = {}, .problems = {}};
  reading.file.path = path;
  reading.file.files = {path};
  reading.path = {fs::weakly_canonical(path).string()};
  FileReader(reading, path).read(yaml, {});
  return finish(std::move(reading));
}

}  // namespace splatbus::cli
