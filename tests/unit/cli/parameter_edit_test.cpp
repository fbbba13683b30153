#include "parameter_edit.h"

#include <gmock/gmock.h>

#include "launch_file.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;

constexpr const char* kFile = R"(# The yard.
services:
  - name: bus   # first

  - name: trainer
    # What it may cost.
    parameters:
      batch: 2      # views
      world: "a b"  # kept

      rate: 'it''s'
    after: [bus]

  - name: viewer
    parameters: {size: 160, probe: true}  # small
  - {name: relight, after: [trainer]}
  - name: engine
    args: [--fps,
           "30"]
# The end.
)";

std::string changed(const std::string& service, const std::map<std::string, std::string>& changes) {
  return with_parameters(kFile, "x.yaml", service, changes);
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

TEST(ParameterEdit, ReplacesAValueWhereItStands) {
  EXPECT_EQ(changed("trainer", {{"batch", "16"}}), replaced(kFile, "batch: 2 ", "batch: 16 "));
  EXPECT_EQ(changed("trainer", {{"world", "c"}}), replaced(kFile, "\"a b\"", "c"));
  EXPECT_EQ(changed("trainer", {{"rate", "-2.5"}}), replaced(kFile, "'it''s'", "-2.5"));
  EXPECT_EQ(changed("viewer", {{"size", "200"}, {"probe", "false"}}),
            replaced(kFile, "size: 160, probe: true", "size: 200, probe: false"));
}

TEST(ParameterEdit, AddsBesideTheOthers) {
  EXPECT_EQ(changed("trainer", {{"seed", "3"}, {"batch", "4"}}),
            replaced(replaced(kFile, "batch: 2 ", "batch: 4 "), "'it''s'\n", "'it''s'\n      seed: 3\n"));
  EXPECT_EQ(changed("viewer", {{"fps", "10"}}), replaced(kFile, "{size", "{fps: 10, size"));
  EXPECT_EQ(changed("bus", {{"a", "b"}}), replaced(kFile, "# first\n", "# first\n    parameters:\n      a: b\n"));
  EXPECT_EQ(changed("engine", {{"a", "b"}}), replaced(kFile, "\"30\"]\n", "\"30\"]\n    parameters:\n      a: b\n"));
  EXPECT_EQ(changed("relight", {{"bias", "1"}}), replaced(kFile, "relight,", "relight, parameters: {bias: 1},"));
}

TEST(ParameterEdit, TextsReadBackAsTheyAre) {
  for (const char* text : {"a: b", "", "# no comment", "\"", "it's", "x,y", "{a}", "${name}", "null", "a\\b", "é", "-",
                           "tcp://*:7600", "0,0.25,0", "*a", "line\nbreak", "@", " x "}) {
    for (const char* service : {"trainer", "viewer", "relight", "bus"}) {
      const LaunchFile file = parse_launch_file(changed(service, {{"text", text}, {"size", text}}), "x.yaml");
      for (const LaunchService& entry : file.services) {
        if (entry.name != service) continue;
        const std::string expected = std::string(text) == "${name}" ? "$${name}" : text;
        EXPECT_EQ(entry.parameters.at("text").value, expected) << service;
        EXPECT_EQ(entry.parameters.at("size").value, expected) << service;
      }
    }
  }
}

TEST(ParameterEdit, RefusesWhatItDoesNotUnderstand) {
  const auto error_of = [](const std::string& yaml, const std::string& service) -> std::string {
    try {
      return with_parameters(yaml, "x.yaml", service, {{"size", "1"}});
    } catch (const LaunchError& error) {
      return error.what();
    }
  };
  EXPECT_THAT(error_of(kFile, "streamer"), HasSubstr("x.yaml: has no service 'streamer' of its own"));
  EXPECT_THAT(error_of("services: [", "a"), HasSubstr("not YAML"));
  EXPECT_THAT(error_of("services:\n  - name: a\n    parameters:\n      size: >\n        b\n        c\n", "a"),
              HasSubstr("x.yaml:4:13: change 'size' by hand"));
  EXPECT_THAT(error_of("x: &x 3\nservices:\n  - name: a\n    parameters: {size: *x}\n", "a"), HasSubstr("by hand"));
  EXPECT_THAT(error_of("services:\n  - name: a\n    parameters: 3\n", "a"), HasSubstr("x.yaml:3:17: "));
}

TEST(ParameterEdit, AnEmptyMapGetsNoComma) {
  EXPECT_EQ(with_parameters("services:\n  - name: a\n    parameters: {}\n", "x.yaml", "a", {{"b", "1"}}),
            "services:\n  - name: a\n    parameters: {b: 1}\n");
}

TEST(ParameterEdit, AFileWithoutALastLineBreakIsGood) {
  EXPECT_EQ(with_parameters("services:\n  - name: a", "x.yaml", "a", {{"b", "1"}}),
            "services:\n  - name: a\n    parameters:\n      b: 1");
}

}  // namespace
}  // namespace splatbus::cli
