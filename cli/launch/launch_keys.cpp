#include "launch_keys.h"

#include <array>
#include <cstddef>

namespace splatbus::cli {

namespace {

constexpr int kMaxReplicas = 64, kMostNice = 19;
constexpr double kNoBound = 1e18;
const std::vector<std::string> kBackends{"cpu", "cuda", "auto"};
const std::vector<std::string> kPolicies{"always", "on-failure", "never"};
const std::vector<std::string> kTypes{"text", "integer", "number", "boolean"};

/// A number of seconds.
template <class T, class Member>
Key<T> seconds(const char* name, Member member, const char* text, double minimum = 0) {
  return {{.name = name, .shape = Shape::Number, .text = text, .minimum = minimum},
          [member, minimum](T& target, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
            target.*member = reader.number(value, what, minimum, kNoBound);
          }};
}

template <class T, class Member>
Key<T> count(const char* name, Member member, const char* text, int minimum, int maximum) {
  return {{.name = name,
           .shape = Shape::Integer,
           .text = text,
           .minimum = static_cast<double>(minimum),
           .maximum = static_cast<double>(maximum)},
          [=](T& target, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
            target.*member = reader.integer(value, what, minimum, maximum);
          }};
}

RestartPolicy policy_of(const std::string& name) {
  return name == "always" ? RestartPolicy::Always : name == "never" ? RestartPolicy::Never : RestartPolicy::OnFailure;
}

const std::vector<Key<RestartRules>>& restart_keys() {
  static const std::vector<Key<RestartRules>> keys{
      {{.name = "policy", .shape = Shape::Choice, .text = "when it is started again", .choices = kPolicies},
       [](RestartRules& rules, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         rules.policy = policy_of(reader.choice(value, what, kPolicies));
       }},
      count<RestartRules>("max_attempts", &RestartRules::max_attempts,
                          "starts in a row after which it has failed for good (default 8; 0: no limit)", 0, 1000000),
      seconds<RestartRules>("window_s", &RestartRules::window_s,
                            "once ready for that long, attempts count anew (default 10)"),
      seconds<RestartRules>("first_delay_s", &RestartRules::first_delay_s,
                            "delay before the second start; it doubles with every attempt (default 0.1)"),
      seconds<RestartRules>("max_delay_s", &RestartRules::max_delay_s, "longest delay (default 8)"),
  };
  return keys;
}

Key<Probe> probe_target(const char* name, Probe::Kind kind, const char* text) {
  return {{.name = name, .shape = Shape::Text, .text = text},
          [kind](Probe& probe, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
            if (!probe.target.empty() || !probe.command.empty()) {
              reader.refuse(value, "a probe has one of tcp, http and command");
            }
            probe.kind = kind;
            probe.target = reader.scalar(value, what);
            const bool good = kind == Probe::Kind::Http
                                  ? probe.target.starts_with("http://")
                                  : probe.target.find(':') != std::string::npos && !probe.target.starts_with(':');
            if (!good) {
              reader.refuse(value,
                            fmt::format("{} must be {}, not '{}'", what,
                                        kind == Probe::Kind::Http ? "an http:// URL" : "HOST:PORT", probe.target));
            }
          }};
}

const std::vector<Key<Probe>>& probe_keys() {
  static const std::vector<Key<Probe>> keys{
      probe_target("tcp", Probe::Kind::Tcp, "HOST:PORT that accepts a connection"),
      probe_target("http", Probe::Kind::Http, "http:// URL that answers with a status of 200 to 399"),
      {{.name = "command", .shape = Shape::TextList, .text = "program and arguments that end with status 0"},
       [](Probe& probe, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         if (!probe.target.empty()) reader.refuse(value, "a probe has one of tcp, http and command");
         probe.kind = Probe::Kind::Command;
         for (const auto& item : reader.list(value, what)) {
           probe.command.push_back(reader.scalar(item, "an item of " + what));
         }
         if (probe.command.empty()) reader.refuse(value, what + " is empty");
       }},
      seconds<Probe>("period_s", &Probe::period_s, "from one probe to the next (default 1)", 0.05),
      seconds<Probe>("timeout_s", &Probe::timeout_s, "after which an answer counts as a failure (default 1)", 0.01),
      count<Probe>("failures", &Probe::failures, "failures in a row that count (default 3)", 1, 1000),
  };
  return keys;
}

Key<LaunchService> probe(const char* name, std::optional<Probe> LaunchService::*member, const char* text) {
  return {{.name = name, .shape = Shape::Object, .text = text, .keys = rules_of(probe_keys())},
          [=](LaunchService& service, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
            Probe read;
            read.mark = reader.mark(value);
            const std::size_t before = reader.problems().size();
            read_keys(reader, value, probe_keys(), read, what, fmt::format(" of {}", what));
            if (reader.problems().size() == before && read.target.empty() && read.command.empty()) {
              reader.refuse(value, what + " needs tcp, http or command");
            }
            service.*member = read;
          }};
}

using Texts = std::map<std::string, Marked<std::string>>;

Texts read_texts(const YamlReader& reader, const YAML::Node& map, const std::string& what) {
  Texts texts;
  reader.each_entry(map, what, [&](const std::string& name, const YAML::Node&, const YAML::Node& value) {
    texts[name] = {reader.process_scalar(value, fmt::format("'{}' in {}", name, what)), reader.mark(value)};
  });
  return texts;
}

}  // namespace

const std::vector<Key<LaunchService>>& service_keys() {
  using Service = LaunchService;
  static const std::vector<Key<Service>> keys{
      {{.name = "name",
        .shape = Shape::Text,
        .text = "source on the bus, unique there; the program is splatbus-NAME unless 'program' says otherwise",
        .required = true},
       [](Service&, const YamlReader&, const YAML::Node&, const std::string&) {}},
      {{.name = "program",
        .shape = Shape::Text,
        .text = "program to run: a name beside the splatbus program, or a path, relative to this file"},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         s.program = {reader.scalar(value, what), reader.mark(value)};
       }},
      {{.name = "parameters", .shape = Shape::TextMap, .text = "parameters, as --set name=value gives them"},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         for (auto& [name, text] : read_texts(reader, value, what)) s.parameters[name] = text;
       }},
      {{.name = "args", .shape = Shape::TextList, .text = "arguments of the program"},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         s.args.clear();
         s.arg_marks.clear();
         for (const auto& item : reader.list(value, what)) {
           s.args.push_back(reader.process_scalar(item, "an item of " + what));
           s.arg_marks.push_back(reader.mark(item));
         }
       }},
      {{.name = "environment", .shape = Shape::TextMap, .text = "environment variables, added to those of the launch"},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         for (auto& [name, text] : read_texts(reader, value, what)) s.environment[name] = text.value;
       }},
      {{.name = "endpoint", .shape = Shape::Text, .text = "short for the parameter 'endpoint'"},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         s.parameters["endpoint"] = {reader.process_scalar(value, what), reader.mark(value)};
       }},
      {{.name = "backend",
        .shape = Shape::Choice,
        .text = "device that it computes on (default: the file's)",
        .choices = kBackends},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         s.backend = {reader.choice(value, what, kBackends), reader.mark(value)};
       }},
      count<Service>("replicas", &Service::replicas, "processes of it, NAME-1, NAME-2, ... (default 1)", 1,
                     kMaxReplicas),
      count<Service>("nice", &Service::nice,
                     "niceness, as of nice(1): the higher, the more of the processor it leaves to others (default 0)",
                     0, kMostNice),
      {{.name = "restart",
        .shape = Shape::Choice,
        .text = "when it is started again (default on-failure), or a map that also says how often",
        .choices = kPolicies,
        .keys = rules_of(restart_keys())},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         if (value.IsMap()) {
           read_keys(reader, value, restart_keys(), s.restart, what, fmt::format(" of {}", what));
         } else {
           s.restart.policy = policy_of(reader.choice(value, what, kPolicies));
         }
       }},
      {{.name = "after", .shape = Shape::TextList, .text = "services that have to be ready before it starts"},
       [](Service& s, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         s.after.clear();
         for (const auto& item : reader.list(value, what)) {
           s.after.push_back({reader.scalar(item, "an item of " + what), reader.mark(item)});
         }
       }},
      seconds<Service>("heartbeat_timeout_s", &Service::heartbeat_timeout_s,
                       "silence after which it is killed and started again (default 5); use 0 for programs that send "
                       "no heartbeat"),
      seconds<Service>("start_timeout_s", &Service::start_timeout_s,
                       "time until it has to be ready, else it is killed and started again (default 30)"),
      seconds<Service>("stop_timeout_s", &Service::stop_timeout_s,
                       "time from SIGTERM to SIGKILL when it is stopped (default 3)"),
      probe("readiness", &Service::readiness, "has to be good once before it counts as ready"),
      probe("liveness", &Service::liveness, "once it is not, the process is killed and started again"),
  };
  return keys;
}

const std::vector<Key<Include>>& include_keys() {
  static const std::vector<Key<Include>> keys{
      {{.name = "file", .shape = Shape::Text, .text = "launch file, relative to this one", .required = true},
       [](Include& include, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         include.file = {reader.scalar(value, what), reader.mark(value)};
       }},
      {{.name = "arguments", .shape = Shape::TextMap, .text = "values of that file's arguments"},
       [](Include& include, const YamlReader& reader, const YAML::Node& map, const std::string& what) {
         reader.each_entry(map, what, [&](const std::string& name, const YAML::Node& key, const YAML::Node& value) {
           include.arguments[name] = {reader.scalar(value, fmt::format("'{}' in {}", name, what)), reader.mark(key)};
         });
       }},
  };
  return keys;
}

const std::vector<Key<ArgumentRule>>& argument_keys() {
  static const std::vector<Key<ArgumentRule>> keys{
      {{.name = "type", .shape = Shape::Choice, .text = "default: as the default looks, else text", .choices = kTypes},
       [](ArgumentRule& rule, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         rule.type = reader.choice(value, what, kTypes);
       }},
      {{.name = "default", .shape = Shape::Text, .text = "value when none is given; without it one has to be"},
       [](ArgumentRule& rule, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         rule.default_value = {reader.scalar(value, what), reader.mark(value)};
       }},
      {{.name = "minimum", .shape = Shape::Number, .text = "least value of a number", .minimum = -kNoBound},
       [](ArgumentRule& rule, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         rule.minimum = reader.number(value, what, -kNoBound, kNoBound);
       }},
      {{.name = "maximum", .shape = Shape::Number, .text = "greatest value of a number", .minimum = -kNoBound},
       [](ArgumentRule& rule, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         rule.maximum = reader.number(value, what, -kNoBound, kNoBound);
       }},
      {{.name = "choices", .shape = Shape::TextList, .text = "values of a text"},
       [](ArgumentRule& rule, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         for (const auto& item : reader.list(value, what)) rule.choices.push_back(reader.scalar(item, what));
       }},
      {{.name = "text", .shape = Shape::Text, .text = "what it is, for whoever launches the file"},
       [](ArgumentRule& rule, const YamlReader& reader, const YAML::Node& value, const std::string& what) {
         rule.text = reader.scalar(value, what);
       }},
  };
  return keys;
}

const std::vector<KeyRule>& file_keys() {
  static const std::vector<KeyRule> keys{
      {.name = "arguments",
       .shape = Shape::ObjectMap,
       .text = "values that 'splatbus launch FILE name=value' gives; ${name} stands for one",
       .keys = rules_of(argument_keys())},
      {.name = "variables", .shape = Shape::TextMap, .text = "texts that ${name} stands for"},
      {.name = "include",
       .shape = Shape::ObjectList,
       .text = "launch files whose services come before this one's, which may change them by their names",
       .keys = rules_of(include_keys())},
      {.name = "bus",
       .shape = Shape::Text,
       .text = "bus of all services, ipc:///folder or tcp://host:port (default: SPLATBUS_BUS, else one of this user)"},
      {.name = "backend",
       .shape = Shape::Choice,
       .text = "default backend for services that set none",
       .choices = kBackends},
      {.name = "world", .shape = Shape::Text, .text = "folder that keeps the model across runs, relative to this file"},
      {.name = "services",
       .shape = Shape::ObjectList,
       .text = "processes to run, each after those that it waits for",
       .keys = rules_of(service_keys())},
  };
  return keys;
}

}  // namespace splatbus::cli
