#include "launch_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

namespace splatbus::cli {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

std::string error_of(const std::string& yaml) {
  try {
    static_cast<void>(parse_launch_file(yaml, "x.yaml"));
  } catch (const LaunchError& error) {
    return error.what();
  }
  return "no error";
}

TEST(LaunchFile, ReadsEveryKey) {
  const LaunchFile file = parse_launch_file(R"(
bus: ipc:///tmp/somewhere
backend: cuda
services:
  - name: bus
  - name: engine
    program: splatbus-engine-sim
    args: [--fps, "30"]
    environment: {LIBGL_ALWAYS_SOFTWARE: "1"}
    restart: always
    after: [bus]
    heartbeat_timeout_s: 2.5
    start_timeout_s: 60
  - name: viewer
    parameters:
      size: 160
      probe: true
    endpoint: tcp://127.0.0.1:5999
    backend: cpu
    replicas: 3
    nice: 5
    restart: {policy: never, max_attempts: 3, window_s: 60, first_delay_s: 0.5, max_delay_s: 20}
    stop_timeout_s: 7
    readiness: {tcp: "127.0.0.1:5999", period_s: 0.5}
    liveness: {command: [test, -e, /tmp/alive], timeout_s: 2, failures: 5}
)",
                                            "x.yaml");
  EXPECT_EQ(file.bus->value, "ipc:///tmp/somewhere");
  ASSERT_EQ(file.services.size(), 3U);
  EXPECT_EQ(file.services[0].program.value, "splatbus-bus");
  EXPECT_EQ(file.services[0].restart.policy, RestartPolicy::OnFailure);
  const LaunchService& engine = file.services[1];
  EXPECT_EQ(engine.program.value, "splatbus-engine-sim");
  EXPECT_EQ(engine.args, (std::vector<std::string>{"--fps", "30"}));
  EXPECT_EQ(engine.environment.at("LIBGL_ALWAYS_SOFTWARE"), "1");
  EXPECT_EQ(engine.restart.policy, RestartPolicy::Always);
  ASSERT_EQ(engine.after.size(), 1U);
  EXPECT_EQ(engine.after[0].value, "bus");
  EXPECT_DOUBLE_EQ(engine.heartbeat_timeout_s, 2.5);
  EXPECT_DOUBLE_EQ(engine.start_timeout_s, 60);
  const LaunchService& viewer = file.services[2];
  EXPECT_EQ(viewer.parameters.at("size").value, "160");
  EXPECT_EQ(viewer.parameters.at("probe").value, "true");
  EXPECT_EQ(viewer.parameters.at("endpoint").value, "tcp://127.0.0.1:5999");
  EXPECT_EQ(viewer.parameters.at("size").mark.text(), "x.yaml:16:13");
  EXPECT_EQ(viewer.replicas, 3);
  EXPECT_EQ(viewer.nice, 5);
  EXPECT_EQ(engine.nice, 0);
  EXPECT_EQ(file.backend->value, "cuda");
  EXPECT_EQ(viewer.backend->value, "cpu");
  EXPECT_FALSE(engine.backend.has_value());
  EXPECT_EQ(viewer.restart.policy, RestartPolicy::Never);
  EXPECT_EQ(viewer.restart.max_attempts, 3);
  EXPECT_DOUBLE_EQ(viewer.restart.window_s, 60);
  EXPECT_DOUBLE_EQ(viewer.restart.first_delay_s, 0.5);
  EXPECT_DOUBLE_EQ(viewer.restart.max_delay_s, 20);
  EXPECT_DOUBLE_EQ(viewer.stop_timeout_s, 7);
  EXPECT_EQ(viewer.readiness->kind, Probe::Kind::Tcp);
  EXPECT_EQ(viewer.readiness->target, "127.0.0.1:5999");
  EXPECT_DOUBLE_EQ(viewer.readiness->period_s, 0.5);
  EXPECT_EQ(viewer.liveness->kind, Probe::Kind::Command);
  EXPECT_EQ(viewer.liveness->command, (std::vector<std::string>{"test", "-e", "/tmp/alive"}));
  EXPECT_EQ(viewer.liveness->failures, 5);
}

struct BadCase {
  const char* name;
  const char* yaml;
  const char* place;  ///< how the message begins
  const char* text;   ///< what it also says
};

class BadLaunchFile : public testing::TestWithParam<BadCase> {};

TEST_P(BadLaunchFile, IsRefusedWithItsPlace) {
  const std::string error = error_of(GetParam().yaml);
  EXPECT_THAT(error, StartsWith(GetParam().place));
  EXPECT_THAT(error, HasSubstr(GetParam().text));
}

const BadCase kBadCases[] = {
    {"NotYaml", "services:\n  - name: [bus\n", "x.yaml:3:", "not YAML"},
    {"OpenList", "services: [\n", "x.yaml:2:1:", "not YAML"},
    {"Tabs", "services:\n\t- name: bus\n", "x.yaml:2:2:", "not YAML"},
    {"Empty", "", "x.yaml:1:1:", "must be a map"},
    {"List", "- a\n", "x.yaml:1:1:", "must be a map, not a list"},
    {"NoServices", "bus: ipc:///tmp/a\n", "x.yaml:1:1:", "needs the key services"},
    {"EmptyServices", "services: []\n", "x.yaml:1:11:", "services is empty"},
    {"ServicesNoList", "services: {name: bus}\n", "x.yaml:1:11:", "services must be a list, not a map"},
    {"UnknownTopKey", "services:\n  - name: bus\nservice: 1\n", "x.yaml:3:1:", "unknown key 'service'"},
    {"TopBackend", "backend: gpu\nservices:\n  - name: bus\n", "x.yaml:1:10:", "cpu, cuda or auto, not 'gpu'"},
    {"ServiceBackend", "services:\n  - name: bus\n    backend: [cpu]\n",
     "x.yaml:3:14:", "backend of service 'bus' must be a single value"},
    {"UnknownServiceKey", "services:\n  - name: bus\n    parametres: {}\n",
     "x.yaml:3:5:", "unknown key 'parametres' of service 'bus'; did you mean 'parameters'?"},
    {"DuplicateKey", "services:\n  - name: bus\n    restart: never\n    restart: always\n",
     "x.yaml:4:5:", "key 'restart' appears twice"},
    {"NoName", "services:\n  - program: x\n", "x.yaml:2:5:", "has no name"},
    {"EntryNoMap", "services:\n  - bus\n", "x.yaml:2:5:", "must be a map"},
    {"NameIsList", "services:\n  - name: [bus]\n", "x.yaml:2:11:", "name must be a single value, not a list"},
    {"BadName", "services:\n  - name: a/b\n", "x.yaml:2:11:", "'a/b' may have only letters"},
    {"ParametersNoMap", "services:\n  - name: bus\n    parameters: [a]\n", "x.yaml:3:17:", "must be a map, not a list"},
    {"ParameterNoScalar", "services:\n  - name: bus\n    parameters:\n      size: [1]\n",
     "x.yaml:4:13:", "'size' in parameters of service 'bus' must be a single value"},
    {"ArgsNoList", "services:\n  - name: bus\n    args: --x\n", "x.yaml:3:11:", "must be a list"},
    {"ReplicasText", "services:\n  - name: bus\n    replicas: many\n", "x.yaml:3:15:", "from 1 to 64, not 'many'"},
    {"NiceBelowZero", "services:\n  - name: bus\n    nice: -1\n", "x.yaml:3:11:", "from 0 to 19, not '-1'"},
    {"ReplicasZero", "services:\n  - name: bus\n    replicas: 0\n", "x.yaml:3:15:", "from 1 to 64, not '0'"},
    {"RestartWord", "services:\n  - name: bus\n    restart: sometimes\n",
     "x.yaml:3:14:", "always, on-failure or never, not 'sometimes'"},
    {"TimeoutText", "services:\n  - name: bus\n    heartbeat_timeout_s: soon\n",
     "x.yaml:3:26:", "must be a number, 0 or more, not 'soon'"},
    {"TimeoutNegative", "services:\n  - name: bus\n    start_timeout_s: -1\n", "x.yaml:3:22:", "must be a number"},
    {"TimeoutNan", "services:\n  - name: bus\n    start_timeout_s: .nan\n", "x.yaml:3:22:", "must be a number"},
    {"DuplicateName", "services:\n  - name: bus\n  - name: bus\n",
     "x.yaml:3:11:", "service name 'bus' is taken, first at x.yaml:2:11"},
    {"AfterNobody", "services:\n  - name: bus\n    after: [engine]\n",
     "x.yaml:3:13:", "`after` names unknown service 'engine' (known: bus)"},
    {"AfterItself", "services:\n  - name: bus\n    after: [bus]\n", "x.yaml:3:13:", "circular `after`: bus → bus"},
    {"AfterAlmost", "services:\n  - name: engine\n  - {name: bus, after: [engin]}\n",
     "x.yaml:3:25:", "`after` names unknown service 'engin'; did you mean 'engine'?"},
    {"OwnBus", "services:\n  - name: viewer\n    bus: tcp://127.0.0.1:6000\n", "x.yaml:3:10:", "share one bus"},
    {"UnknownVariable", "variables: {size: 1}\nservices:\n  - {name: viewer, parameters: {size: \"${siez}\"}}\n",
     "x.yaml:3:39:", "unknown variable '${siez}'; did you mean 'size'?"},
    {"MistypedName", "services:\n  - {name: viewer, args: [\"${nmae}\"]}\n",
     "x.yaml:2:27:", "unknown variable '${nmae}'; did you mean 'name'?"},
    {"OpenVariable", "services:\n  - {name: viewer, args: [\"${name\"]}\n", "x.yaml:2:27:", "'${' has no '}'"},
    {"ProcessVariableTooSoon", "bus: ipc://${bus_dir}\nservices:\n  - {name: viewer}\n",
     "x.yaml:1:6:", "'${bus_dir}' is known in parameters, args and environment alone"},
    {"VariableTwice", "arguments: {a: 1}\nvariables: {a: 2}\nservices:\n  - {name: viewer}\n",
     "x.yaml:2:13:", "'${a}' stands for something else already"},
    {"VariableLaughs",
     "variables: {a: aaaaaaaaaaaaaaaaaaaa, b: \"${a}${a}${a}${a}${a}${a}${a}${a}${a}${a}\", "
     "c: \"${b}${b}${b}${b}${b}${b}${b}${b}${b}${b}\", d: \"${c}${c}${c}${c}${c}${c}${c}${c}${c}${c}\", "
     "e: \"${d}${d}${d}${d}${d}${d}${d}${d}${d}${d}\"}\nservices:\n  - {name: viewer}\n",
     "x.yaml:1:", "more than 64 KiB"},
    {"ArgumentWithoutValue", "arguments: {size: {type: integer}}\nservices:\n  - {name: viewer}\n",
     "x.yaml:1:13:", "argument 'size' needs a value: launch x.yaml size=VALUE"},
    {"ArgumentDefault", "arguments: {size: {type: integer, default: big}}\nservices:\n  - {name: viewer}\n",
     "x.yaml:1:44:", "argument 'size' must be a whole number, not 'big'"},
    {"ArgumentKey", "arguments: {size: {typ: integer}}\nservices:\n  - {name: viewer}\n",
     "x.yaml:1:20:", "unknown key 'typ' of argument 'size'; did you mean 'type'?"},
    {"ProbeOfTwoKinds", "services:\n  - {name: a, readiness: {tcp: \"a:1\", http: \"http://a\"}}\n",
     "x.yaml:2:45:", "one of tcp, http"},
    {"ProbeOfNothing", "services:\n  - {name: a, liveness: {period_s: 2}}\n", "x.yaml:2:25:", "needs tcp, http or"},
    {"IncludeNowhere", "include: [nowhere.yaml]\n", "x.yaml:1:11:", "'nowhere.yaml' cannot be read"},
    {"Cycle", "services:\n  - {name: a, after: [b]}\n  - {name: b, after: [c]}\n  - {name: c, after: [a]}\n",
     "x.yaml:4:23:", "circular `after`: a → b → c → a"},
};

INSTANTIATE_TEST_SUITE_P(Cases, BadLaunchFile, testing::ValuesIn(kBadCases),
                         [](const auto& instance) { return std::string(instance.param.name); });

TEST(LaunchFile, MissingFileIsNamed) {
  try {
    static_cast<void>(read_launch_file("/nonexistent/x.yaml"));
    FAIL();
  } catch (const LaunchError& error) {
    EXPECT_THAT(error.what(), StartsWith("/nonexistent/x.yaml: cannot be read"));
  }
}

TEST(LaunchOverride, SetsTheBackendOfTheFile) {
  LaunchFile file = parse_launch_file("backend: auto\nservices:\n  - {name: viewer, backend: cpu}\n", "x.yaml");
  set_backend(file, "");
  EXPECT_EQ(file.backend->value, "auto");
  set_backend(file, "cuda");
  EXPECT_EQ(file.backend->value, "cuda");
  EXPECT_EQ(file.backend->mark.text(), "--backend cuda");
  EXPECT_EQ(file.services[0].backend->value, "cpu");
}

TEST(LaunchOverride, SetsAParameter) {
  LaunchFile file = parse_launch_file("services:\n  - name: viewer\n    parameters: {size: 1}\n", "x.yaml");
  apply_override(file, "viewer.size=2");
  apply_override(file, "viewer.text=a=b.c");
  EXPECT_EQ(file.services[0].parameters.at("size").value, "2");
  EXPECT_EQ(file.services[0].parameters.at("size").mark.text(), "--set viewer.size=2");
  EXPECT_EQ(file.services[0].parameters.at("text").value, "a=b.c");
}

TEST(LaunchFile, AWorldGoesToEveryTrainerThatHasNoneOfItsOwn) {
  const std::string yaml = R"(
world: worlds/yard
services:
  - name: trainer
  - name: second
    program: ../bin/splatbus-trainer
    parameters: {world: /elsewhere}
  - name: viewer
)";
  LaunchFile file = parse_launch_file(yaml, "/launch/x.yaml");
  EXPECT_EQ(file.services[0].parameters.at("world").value, "/launch/worlds/yard");
  EXPECT_EQ(file.services[1].parameters.at("world").value, "/elsewhere");
  EXPECT_FALSE(file.services[2].parameters.contains("world"));
  set_world(file, "");
  EXPECT_EQ(file.services[0].parameters.at("world").value, "/launch/worlds/yard");
  set_world(file, "here");
  EXPECT_EQ(file.services[0].parameters.at("world").value, (std::filesystem::current_path() / "here").string());
  EXPECT_EQ(file.services[1].parameters.at("world").value, "/elsewhere");
  LaunchFile without = parse_launch_file("services:\n  - name: viewer\n", "x.yaml");
  EXPECT_THROW(set_world(without, "here"), LaunchError);
  EXPECT_THROW(parse_launch_file("world: here\nservices:\n  - name: viewer\n", "x.yaml"), LaunchError);
}

std::vector<std::string> places_of(const std::string& yaml) {
  std::vector<std::string> places;
  try {
    static_cast<void>(parse_launch_file(yaml, "x.yaml"));
  } catch (const LaunchError& error) {
    for (const LaunchProblem& problem : error.problems()) places.push_back(problem.mark.text());
  }
  return places;
}

TEST(LaunchFile, EveryProblemIsNamedAtOnce) {
  EXPECT_THAT(places_of("services:\n  - name: bus\n    color: red\n    replicas: 0\n  - name: b/c\n"
                        "  - {name: a, after: 3, args: [\"${x}\"]}\ncolour: 1\n"),
              testing::UnorderedElementsAre("x.yaml:7:1", "x.yaml:3:5", "x.yaml:4:15", "x.yaml:5:11", "x.yaml:6:22",
                                            "x.yaml:6:32"));
  EXPECT_THAT(places_of("services:\n  - {name: a, after: [b]}\n  - {name: c, after: [d]}\n"),
              testing::ElementsAre("x.yaml:2:23", "x.yaml:3:23"));
}

TEST(LaunchOverride, RefusesWhatNamesNothing) {
  LaunchFile file = parse_launch_file("services:\n  - name: viewer\n", "x.yaml");
  for (const char* text : {"", "viewer", "viewer.size", "=1", ".size=1", "viewer.=1", "size=1.5"}) {
    EXPECT_THROW(apply_override(file, text), LaunchError) << text;
  }
  try {
    apply_override(file, "streamer.rate=1");
    FAIL();
  } catch (const LaunchError& error) {
    EXPECT_THAT(error.what(), HasSubstr("--set streamer.rate=1: x.yaml has no service 'streamer' (known: viewer)"));
  }
}

}  // namespace
}  // namespace splatbus::cli
