// What a launch file is given: arguments, variables, and other files that it includes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <utility>

#include "launch_file.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

constexpr const char* kWithArguments = R"(
arguments:
  cameras: {type: integer, default: 8, minimum: 1, maximum: 64, text: how many}
  rig: {default: ring, choices: [ring, follow]}
  rate: 2.5
  label: "7"
  still: false
variables:
  folder: out/${rig}
  each: ${folder}/${name}
services:
  - name: viewer
    replicas: ${cameras}
    parameters: {out: "${each}", label: "${label}", cost: "$${5}", rate: "${rate}"}
)";

TEST(LaunchArguments, AreTypedAndHaveDefaults) {
  const LaunchFile file = parse_launch_file(kWithArguments, "x.yaml");
  const auto& viewer = file.services.at(0);
  EXPECT_EQ(viewer.replicas, 8);
  EXPECT_EQ(viewer.parameters.at("out").value, "out/ring/${name}") << "what is known of a process comes later";
  EXPECT_EQ(viewer.parameters.at("label").value, "7");
  EXPECT_EQ(viewer.parameters.at("cost").value, "$${5}");
  const LaunchFile given =
      parse_launch_file(kWithArguments, "x.yaml", parse_arguments({"cameras=3", "rig=follow", "label=${name}=x"}));
  EXPECT_EQ(given.services.at(0).replicas, 3);
  EXPECT_EQ(given.services.at(0).parameters.at("out").value, "out/follow/${name}");
  EXPECT_EQ(given.services.at(0).parameters.at("label").value, "$${name}=x") << "a value stands for itself";
}

TEST(LaunchArguments, RefusesWhatTheFileDoesNotTake) {
  const std::pair<const char*, const char*> refusals[] = {
      {"cameras=65", "cameras=65: argument 'cameras' must be a whole number from 1 to 64, not '65'"},
      {"cameras=2.5", "argument 'cameras' must be a whole number"},
      {"rate=fast", "argument 'rate' must be a number, not 'fast'"},
      {"still=maybe", "argument 'still' must be true or false"},
      {"rig=folow", "argument 'rig' must be ring or follow, not 'folow'; did you mean 'follow'?"},
      {"camera=3", "camera=3: x.yaml has no argument 'camera'; did you mean 'cameras'?"}};
  for (const auto& [given, text] : refusals) {
    try {
      static_cast<void>(parse_launch_file(kWithArguments, "x.yaml", parse_arguments({given})));
      ADD_FAILURE() << given;
    } catch (const LaunchError& error) {
      EXPECT_THAT(error.what(), HasSubstr(text));
    }
  }
  EXPECT_THROW(static_cast<void>(parse_arguments({"cameras"})), LaunchError);
  EXPECT_THROW(static_cast<void>(parse_arguments({"a=1", "a=2"})), LaunchError);
}

/// A folder of launch files.
class Includes : public testing::Test {
 protected:
  Includes() {
    std::string path = (std::filesystem::temp_directory_path() / "splatbus-include-XXXXXX").string();
    folder_ = mkdtemp(path.data());
  }
  ~Includes() override { std::filesystem::remove_all(folder_); }
  std::string write(const std::string& name, const std::string& yaml) const {
    std::filesystem::create_directories((folder_ / name).parent_path());
    std::ofstream(folder_ / name) << yaml;
    return (folder_ / name).string();
  }
  [[nodiscard]] std::string error_of(const std::string& path) const {
    try {
      static_cast<void>(read_launch_file(path));
    } catch (const LaunchError& error) {
      return error.what();
    }
    return "no error";
  }
  std::filesystem::path folder_;
};

TEST_F(Includes, ServicesComeFirstAndMayBeChanged) {
  write("base/base.yaml",
        "arguments: {size: 10}\nbus: ipc:///tmp/base\nworld: kept\nservices:\n  - name: bus\n"
        "  - name: trainer\n    program: ./mine\n    args: [a, b]\n    parameters: {batch: 2, size: \"${size}\"}\n"
        "  - {name: second, program: splatbus-trainer}\n");
  const std::string path = write("top.yaml",
                                 "include:\n  - {file: base/base.yaml, arguments: {size: 20}}\nbus: ipc:///tmp/top\n"
                                 "services:\n  - name: viewer\n  - name: trainer\n    args: [c]\n"
                                 "    parameters: {batch: 4}\n");
  const LaunchFile file = read_launch_file(path);
  EXPECT_THAT(file.service_names(), testing::ElementsAre("bus", "trainer", "second", "viewer"));
  EXPECT_EQ(file.bus->value, "ipc:///tmp/top");
  EXPECT_EQ(file.world->value, (folder_ / "base/kept").string()) << "relative to the file that says it";
  const LaunchService& trainer = file.services.at(1);
  EXPECT_EQ(trainer.program.value, "./mine");
  EXPECT_EQ(trainer.program.mark.file, (folder_ / "base/base.yaml").string());
  EXPECT_THAT(trainer.args, testing::ElementsAre("c"));
  EXPECT_EQ(trainer.parameters.at("batch").value, "4");
  EXPECT_EQ(trainer.parameters.at("size").value, "20");
  EXPECT_THAT(file.files, testing::ElementsAre(path, (folder_ / "base/base.yaml").string()));
}

TEST_F(Includes, ArgumentsOfTheCommandLineReachThem) {
  write("base.yaml", "arguments: {size: 10}\nservices:\n  - {name: viewer, parameters: {size: \"${size}\"}}\n");
  const std::string path = write("top.yaml", "include: [base.yaml]\n");
  EXPECT_EQ(read_launch_file(path, {{"size", "30"}}).services.at(0).parameters.at("size").value, "30");
  EXPECT_THROW(static_cast<void>(read_launch_file(path, {{"size", "x"}})), LaunchError);
  EXPECT_THROW(static_cast<void>(read_launch_file(path, {{"sized", "30"}})), LaunchError);
}

TEST_F(Includes, CyclesAreRefusedWithTheWayRound) {
  const std::string a = write("a.yaml", "include: [sub/b.yaml]\n");
  const std::string b = write("sub/b.yaml", "services:\n  - name: bus\ninclude:\n  - ../a.yaml\n");
  EXPECT_EQ(error_of(a), b + ":4:5: circular include: " + a + " → " + b + " → " + a);
  const std::string own = write("own.yaml", "include: [own.yaml]\n");
  EXPECT_THAT(error_of(own), HasSubstr(own + ":1:11: circular include"));
}

TEST_F(Includes, NamesAndArgumentsAreCheckedAcrossFiles) {
  write("a.yaml", "services:\n  - name: viewer\n");
  write("b.yaml", "services:\n  - name: viewer\n");
  EXPECT_THAT(error_of(write("two.yaml", "include: [a.yaml, b.yaml]\n")),
              testing::AllOf(StartsWith((folder_ / "b.yaml").string() + ":2:11: "), HasSubstr("is taken, first at")));
  EXPECT_THAT(error_of(write("twice.yaml", "include: [a.yaml]\nservices:\n  - name: viewer\n  - name: viewer\n")),
              HasSubstr("twice.yaml:4:11: service name 'viewer' is taken"));
  EXPECT_THAT(error_of(write("wrong.yaml", "include:\n  - {file: a.yaml, arguments: {size: 1}}\n")),
              HasSubstr("wrong.yaml:2:32: "));
  EXPECT_THAT(error_of(write("folder.yaml", "include: [\".\"]\n")), HasSubstr("folder.yaml:1:11: "));
}

}  // namespace
}  // namespace splatbus::cli
