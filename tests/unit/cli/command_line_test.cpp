#include "bus/command_line.h"

#include <gmock/gmock.h>

#include <CLI/CLI.hpp>
#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include "bus/shorthand.h"

namespace splatbus::cli {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

struct Outcome {
  std::optional<int> status;
  std::string error;
};

Outcome parse(std::vector<const char*> arguments) {
  CLI::App app("what it is", "prog");
  std::string folder;
  double seconds = 0, rate = 1;
  app.require_subcommand(1);
  CLI::App* launch = app.add_subcommand("launch", "");
  CLI::App* topic = app.add_subcommand("topic", "");
  topic->require_subcommand(1);
  topic->add_subcommand("list", "")->add_option("--seconds", seconds)->check(CLI::NonNegativeNumber);
  topic->add_subcommand("echo", "");
  app.add_subcommand("secret", "")->group("");
  auto* group = launch->add_option_group("group", "");
  group->add_option("--folder", folder);
  launch->add_option("--rate", rate)->check(CLI::Range(0.5, 4.0));
  launch->add_option("--wait", seconds)->check(CLI::PositiveNumber);
  // A verb that is one by itself, takes words, and has verbs.
  std::string file, format;
  CLI::App* save = app.add_subcommand("save", "");
  save->add_option("file", file);
  save->add_option("-f,--format", format);
  save->add_subcommand("all", "");
  arguments.insert(arguments.begin(), "prog");
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  Outcome outcome;
  outcome.status = bus::parse_command_line(app, static_cast<int>(arguments.size()), arguments.data());
  static_cast<void>(testing::internal::GetCapturedStdout());
  outcome.error = testing::internal::GetCapturedStderr();
  return outcome;
}

TEST(CommandLine, GoodOnesRunAndHelpEnds) {
  EXPECT_EQ(parse({"launch", "--folder", "x"}).status, std::nullopt);
  EXPECT_EQ(parse({"save", "a.ply", "-f", "ply"}).status, std::nullopt);
  EXPECT_EQ(parse({"save", "all"}).status, std::nullopt);
  EXPECT_EQ(parse({"--help"}).status, 0);
  EXPECT_EQ(parse({"topic", "--help"}).status, 0);
}

TEST(CommandLine, MistypedWordsGetTheNearestAndStatusTwo) {
  const std::pair<std::vector<const char*>, const char*> cases[] = {
      {{"lunch"}, "prog: unknown verb 'lunch'; did you mean 'launch'?"},
      {{"lunch", "x.yaml"}, "unknown verb 'lunch'; did you mean 'launch'?"},
      {{"topic", "lsit"}, "unknown verb 'lsit'; did you mean 'list'?"},
      {{"topic", "whatever"}, "unknown verb 'whatever' (known: "},
      {{"launch", "--foldr", "x"}, "unknown option '--foldr'; did you mean '--folder'?"},
      {{"topic", "list", "--second=1"}, "unknown option '--second'; did you mean '--seconds'?"},
      {{"launch", "--zzzzzzz"}, "unknown option '--zzzzzzz'\n"},
      {{"save", "a.ply", "--formt", "ply"}, "unknown option '--formt'; did you mean '--format'?"},
      {{"save", "-f", "ply", "--formt", "ply"}, "unknown option '--formt'; did you mean '--format'?"},
      {{"save", "al", "a.yaml"}, "unknown verb 'al'; did you mean 'all'?"},
      {{}, "give a verb"},
      {{"topic"}, "give a verb"}};
  for (const auto& [arguments, text] : cases) {
    const Outcome outcome = parse(arguments);
    EXPECT_EQ(outcome.status, 2) << text;
    EXPECT_THAT(outcome.error, HasSubstr(text));
    EXPECT_THAT(outcome.error, Not(HasSubstr("secret")));
  }
}

TEST(CommandLine, RangesAreWrittenAsOneWouldSayThem) {
  EXPECT_THAT(parse({"topic", "list", "--seconds", "-1"}).error, HasSubstr("--seconds: must be 0 or more, not '-1'\n"));
  EXPECT_THAT(parse({"launch", "--rate", "5"}).error, HasSubstr("--rate: must be from 0.5 to 4, not '5'\n"));
  EXPECT_THAT(parse({"launch", "--wait", "0"}).error, HasSubstr("--wait: must be more than 0, not '0'\n"));
  EXPECT_EQ(parse({"launch", "--rate", "5"}).status, 2);
}

struct Short {
  std::optional<int> status;
  std::string backend = "auto";
  std::vector<std::string> changes, set;
};

Short parse_short(std::vector<const char*> arguments) {
  const std::vector<bus::Shorthand> flags{{"--window", "window=true", "a window"},
                                          {"--record", "packet_log=", "a file"},
                                          {"--backend gl", "opengl=true", "OpenGL"}};
  CLI::App app("what it is", "prog");
  Short result;
  app.add_option("--set", result.set)->allow_extra_args(false);
  bus::add_backend_and_shorthands(app, flags, result.backend, result.changes);
  arguments.insert(arguments.begin(), "prog");
  testing::internal::CaptureStderr();
  result.status = bus::parse_command_line(app, static_cast<int>(arguments.size()), arguments.data());
  static_cast<void>(testing::internal::GetCapturedStderr());
  return result;
}

TEST(Shorthands, AreSettingsInWhateverWayTheyAreWritten) {
  for (const std::vector<const char*>& record : {std::vector{"--record", "a=b.log"}, std::vector{"--record=a=b.log"}}) {
    EXPECT_THAT(parse_short(record).changes, ElementsAre("packet_log=a=b.log"));
  }
  for (const std::vector<const char*>& gl : {std::vector{"--backend", "gl"}, std::vector{"--backend=gl"}}) {
    const Short given = parse_short(gl);
    EXPECT_THAT(given.changes, ElementsAre("opengl=true"));
    EXPECT_EQ(given.backend, "auto");
  }
  EXPECT_THAT(parse_short({"--window"}).changes, ElementsAre("window=true"));
  EXPECT_EQ(parse_short({"--backend", "cuda"}).backend, "cuda");
  EXPECT_THAT(parse_short({"--backend", "cuda"}).changes, IsEmpty());
  EXPECT_EQ(parse_short({"--backend", "vulkan"}).status, 2);
}

TEST(Shorthands, MayBeRepeatedAndStandBesideOtherSettings) {
  const Short both = parse_short({"--backend", "gl", "--backend", "cpu", "--set", "fps=30", "--set", "path=fly"});
  EXPECT_THAT(both.changes, ElementsAre("opengl=true"));
  EXPECT_EQ(both.backend, "cpu");
  EXPECT_THAT(both.set, ElementsAre("fps=30", "path=fly"));
  EXPECT_THAT(parse_short({"--window", "--window"}).changes, ElementsAre("window=true"));
  EXPECT_THAT(parse_short({"--record", "a", "--record", "b"}).changes, ElementsAre("packet_log=b"));
}

TEST(Shorthands, OfABackendGoIntoTheEnvironmentToo) {
  ::setenv("SPLATBUS_BACKEND", "gl", 1);
  const Short given = parse_short({});
  ::unsetenv("SPLATBUS_BACKEND");
  EXPECT_EQ(given.status, std::nullopt);
  EXPECT_THAT(given.changes, ElementsAre("opengl=true"));
  EXPECT_EQ(given.backend, "auto");
}

TEST(Shorthands, OfABackendLeaveTheDeviceToTheEnvironment) {
  ::setenv("SPLATBUS_BACKEND", "cpu", 1);
  const Short given = parse_short({"--backend", "gl"});
  ::unsetenv("SPLATBUS_BACKEND");
  EXPECT_THAT(given.changes, ElementsAre("opengl=true"));
  EXPECT_EQ(given.backend, "cpu");
}

}  // namespace
}  // namespace splatbus::cli
