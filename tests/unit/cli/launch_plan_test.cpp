#include "launch_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "parameter_check.h"

namespace splatbus::cli {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::HasSubstr;

/// A folder with programs that do what a line of shell says.
class LaunchPlanTest : public testing::Test {
 protected:
  LaunchPlanTest() {
    std::string path = (fs::temp_directory_path() / "splatbus-plan-XXXXXX").string();
    programs_ = mkdtemp(path.data());
    for (const char* name : {"splatbus-bus", "splatbus-engine-sim", "splatbus-trainer", "splatbus-viewer"})
      program(name, "exit 0");
  }
  ~LaunchPlanTest() override { fs::remove_all(programs_); }

  void program(const std::string& name, const std::string& script) const {
    std::ofstream(programs_ / name) << "#!/bin/sh\n" << script << "\n";
    fs::permissions(programs_ / name, fs::perms::owner_all);
  }

  [[nodiscard]] LaunchPlan plan(const std::string& yaml) const {
    return plan_launch(parse_launch_file(yaml, "x.yaml"), bus::Address::parse("ipc:///tmp/b"), programs_);
  }

  [[nodiscard]] std::string error_of(const std::string& yaml) const {
    try {
      const LaunchFile file = parse_launch_file(yaml, "x.yaml");
      check_parameters(file, plan_launch(file, bus::Address::parse("ipc:///tmp/b"), programs_));
    } catch (const LaunchError& error) {
      return error.what();
    }
    return "no error";
  }

  fs::path programs_;
};

std::vector<std::string> names(const LaunchPlan& plan) {
  std::vector<std::string> result;
  for (const ProcessPlan& process : plan.processes) result.push_back(process.name);
  return result;
}

TEST_F(LaunchPlanTest, BrokerFirstAndDependenciesBefore) {
  const LaunchPlan p = plan(R"(
services:
  - {name: viewer, after: [trainer]}
  - {name: trainer, after: [engine]}
  - {name: engine, program: splatbus-engine-sim}
  - {name: bus}
)");
  EXPECT_THAT(names(p), ElementsAre("bus", "engine", "trainer", "viewer"));
  EXPECT_TRUE(p.processes[0].broker);
  EXPECT_THAT(p.processes[0].arguments, ElementsAre("--bus", "ipc:///tmp/b"));
  EXPECT_THAT(p.processes[0].after, ElementsAre());
  EXPECT_THAT(p.processes[1].after, ElementsAre(0));
  EXPECT_THAT(p.processes[2].after, ElementsAre(0, 1));
  EXPECT_THAT(p.processes[3].after, ElementsAre(0, 2));
}

TEST_F(LaunchPlanTest, ArgumentsAndEnvironment) {
  const LaunchPlan p = plan(R"(
services:
  - name: viewer
    args: [--verbose]
    parameters: {size: 160, out: "${bus_dir}/${name}"}
    environment: {A: "${name}"}
)");
  const ProcessPlan& viewer = p.processes.at(0);
  EXPECT_EQ(viewer.program, programs_ / "splatbus-viewer");
  EXPECT_THAT(viewer.arguments, ElementsAre("--bus", "ipc:///tmp/b", "--name", "viewer", "--verbose", "--set",
                                            "out=/tmp/b/viewer", "--set", "size=160"));
  EXPECT_EQ(viewer.environment.at("SPLATBUS_BUS"), "ipc:///tmp/b");
  EXPECT_EQ(viewer.environment.at("A"), "viewer");
}

TEST_F(LaunchPlanTest, AVerbComesFirst) {
  const LaunchPlan p = plan(R"(
services:
  - {name: tape, program: splatbus-viewer, args: [record, --seconds, "3"]}
)");
  EXPECT_THAT(p.processes.at(0).arguments,
              ElementsAre("record", "--seconds", "3", "--bus", "ipc:///tmp/b", "--name", "tape"));
}

TEST_F(LaunchPlanTest, ABackendOfAServiceGoesBeforeTheFiles) {
  const LaunchPlan p = plan(R"(
backend: auto
services:
  - {name: engine, program: splatbus-engine-sim}
  - {name: trainer, backend: cpu}
)");
  EXPECT_EQ(p.processes[0].environment.at("SPLATBUS_BACKEND"), "auto");
  EXPECT_EQ(p.processes[1].environment.at("SPLATBUS_BACKEND"), "cpu");
  const LaunchPlan silent = plan("services:\n  - {name: trainer}\n");
  EXPECT_FALSE(silent.processes[0].environment.contains("SPLATBUS_BACKEND")) << "ours is passed on";
}

TEST_F(LaunchPlanTest, HeartbeatSourcesAreThoseThatSendThem) {
  const LaunchFile file = parse_launch_file(R"(
services:
  - {name: bus}
  - {name: viewer, replicas: 2}
  - {name: job, program: /bin/sh, heartbeat_timeout_s: 0}
  - {name: engine, program: splatbus-engine-sim}
)",
                                            "x.yaml");
  EXPECT_THAT(heartbeat_sources(file), ElementsAre("viewer-1", "viewer-2", "engine"));
}

TEST_F(LaunchPlanTest, ReplicasAreNumberedAndAllWaitedFor) {
  const LaunchPlan p = plan(R"(
services:
  - {name: viewer, replicas: 2, parameters: {out: "out/${replica}"}}
  - {name: trainer, after: [viewer]}
)");
  EXPECT_THAT(names(p), ElementsAre("viewer-1", "viewer-2", "trainer"));
  EXPECT_EQ(p.processes[1].arguments.back(), "out=out/2");
  EXPECT_THAT(p.processes[2].after, ElementsAre(0, 1));
}

TEST_F(LaunchPlanTest, ProgramsWithoutHeartbeatGetTheirOwnArgumentsOnly) {
  const LaunchPlan p = plan("services:\n  - {name: job, program: /bin/sh, args: [-c, ls], heartbeat_timeout_s: 0}\n");
  EXPECT_THAT(p.processes.at(0).arguments, ElementsAre("-c", "ls"));
}

TEST_F(LaunchPlanTest, UnknownServicesAreNamedWithThoseThatExist) {
  const std::string error = error_of("services:\n  - name: trianer\n");
  EXPECT_THAT(error, HasSubstr("x.yaml:2:11: no program 'splatbus-trianer'"));
  EXPECT_THAT(error, HasSubstr("did you mean 'splatbus-trainer'?"));
  EXPECT_THAT(error_of("services:\n  - name: painter\n  - name: drawing_office\n"),
              testing::AllOf(HasSubstr("x.yaml:2:11: "), HasSubstr("x.yaml:3:11: "),
                             HasSubstr("splatbus-bus, splatbus-engine-sim, splatbus-trainer, splatbus-viewer")));
  EXPECT_THAT(error_of("services:\n  - {name: a, program: /nonexistent/a}\n"),
              HasSubstr("x.yaml:2:24: '/nonexistent/a' is not an executable program"));
}

TEST_F(LaunchPlanTest, OfSomeServicesThereIsOne) {
  program("splatbus-expander", "exit 0");
  for (const std::string name : {"bus", "trainer", "expander"}) {
    EXPECT_THAT(error_of("services:\n  - {name: " + name + ", replicas: 2}\n"),
                HasSubstr("'" + name + "' cannot have 2 replicas: a bus has one"));
  }
  EXPECT_EQ(error_of("services:\n  - {name: trainer, replicas: 1}\n"), "no error");
}

TEST_F(LaunchPlanTest, ClashingReplicaNames) {
  EXPECT_THAT(error_of("services:\n  - {name: viewer, replicas: 2}\n  - {name: viewer-2, program: splatbus-viewer}\n"),
              HasSubstr("process name 'viewer-2' is taken"));
  EXPECT_THAT(error_of("services:\n  - {name: a, program: /bin/sh, heartbeat_timeout_s: 0, parameters: {x: 1}}\n"),
              HasSubstr("'a' takes no parameters: use 'args'"));
}

TEST_F(LaunchPlanTest, ParametersAreCheckedByTheProgram) {
  program("splatbus-trainer",
          R"(echo '{"parameters": [], "problems": [{"parameter": "bacth", "text": "no bacth"},)"
          R"({"parameter": "rate", "text": "no rate"}, {"parameter": "", "text": "not together"}]}'; exit 2)");
  EXPECT_EQ(error_of("services:\n  - name: trainer\n    parameters:\n      rate: 1\n      bacth: 2\n"),
            "x.yaml:5:14: service 'trainer': no bacth\nx.yaml:4:13: service 'trainer': no rate\n"
            "x.yaml:2:11: service 'trainer': not together");
  program("splatbus-trainer", "for a; do before=$last; last=$a; done; [ \"$before $last\" = '--parameters --json' ]");
  EXPECT_EQ(error_of("services:\n  - name: trainer\n    parameters: {batch: 1}\n"), "no error");
}

TEST_F(LaunchPlanTest, ArgumentsAreCheckedByTheProgram) {
  program("splatbus-engine-sim",
          "echo \"splatbus-engine-sim: unknown option '--dynamcs'\" >&2; echo 'Run with --help ...' >&2; exit 2");
  EXPECT_EQ(error_of("services:\n  - name: engine\n    program: splatbus-engine-sim\n    args: [--fps, --dynamcs]\n"),
            "x.yaml:4:19: service 'engine' refuses its arguments: splatbus-engine-sim: unknown option '--dynamcs'");
  program("job", "touch " + (programs_ / "ran").string());
  EXPECT_EQ(error_of("services:\n  - {name: job, program: " + (programs_ / "job").string() + ", args: [x]}\n"),
            "no error");
  EXPECT_FALSE(fs::exists(programs_ / "ran")) << "programs of others know nothing of --parameters";
}

TEST_F(LaunchPlanTest, VariablesOfAProcess) {
  const LaunchPlan p = plan("services:\n  - {name: viewer, args: [\"--$${name}\", \"${name}\"]}\n");
  EXPECT_THAT(p.processes.at(0).arguments,
              ElementsAre("--bus", "ipc:///tmp/b", "--name", "viewer", "--${name}", "viewer"));
  LaunchFile file = parse_launch_file("services:\n  - name: viewer\n", "x.yaml");
  apply_override(file, "viewer.out=${nmae}");
  try {
    static_cast<void>(plan_launch(file, bus::Address::parse("ipc:///tmp/b"), programs_));
    FAIL();
  } catch (const LaunchError& error) {
    EXPECT_THAT(error.what(), HasSubstr("--set viewer.out=${nmae}: unknown variable '${nmae}'; did you mean 'name'?"));
  }
}

/// Programs of others: what they print goes to a terminal, and they may never end.
TEST_F(LaunchPlanTest, WhatAForeignProgramPrintsIsNotTrusted) {
  program("rude", "printf '\\033[2Jmine\\a'; exit 1");
  const std::string text = error_of("services: [{name: a, program: rude, parameters: {b: 1}}]");
  EXPECT_THAT(text, HasSubstr("service 'a' refuses its arguments: ?[2Jmine?"));
  EXPECT_EQ(text.find('\033'), std::string::npos);
  program("endless", "exec yes 0123456789012345678901234567890123456789");
  EXPECT_EQ(error_of("services: [{name: a, program: endless, parameters: {b: 1}}]"), "no error");
  program("splatbus-trainer", "exec yes 0123456789012345678901234567890123456789");
  EXPECT_THAT(error_of("services: [{name: trainer}]"), HasSubstr("its program does not answer to --parameters"));
  EXPECT_FALSE(ask_parameters(programs_ / "splatbus-trainer", {}, {}).has_value());
}

}  // namespace
}  // namespace splatbus::cli
