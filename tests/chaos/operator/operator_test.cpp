// A live pipeline under a turning sun, with two viewers, one of whom walks, which an operator swaps, scales, restarts
// and changes by chance and by seed, while processes die: see ChaosOptions. After each the pictures are back, and the
// Gaussians are the same; at the end nothing is left that was not there at the start.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <fstream>

#include "../../integration/pipeline.h"
#include "../chaos_fixture.h"
#include "bus/clock.h"
#include "fault.h"

namespace splatbus::chaos {
namespace {

using namespace std::chrono_literals;

/// What may be lacking where another engine begins, and its sun with it: that is another picture.
constexpr double kOtherSunLoss = 0.05;

/// Of those who look, one orbits and one walks.
std::string launch_file() {
  static const cli::PrivateBusFolder folder;
  const std::string path_file = folder.path() / "walk.txt";
  std::ofstream(path_file) << "4 1.5 0\n0 1.5 4\n-4 1.5 0\n0 1.5 -4\n";
  std::string text = cli::Pipeline::launch_file();
  const std::string args = R"(args: [--fps, "10"])";
  text.replace(text.find(args), args.size(), R"(args: [--fps, "10", --sun-rate, "1"])");
  return text + R"(
  - name: second-viewer
    program: splatbus-viewer
    parameters: {threads: 1, width: 64, height: 64, path: walk, path_end: loop, path_file: )" +
         path_file + "}\n";
}

class OperatorChaos : public ChaosTest {
 protected:
  OperatorChaos() : ChaosTest(launch_file()) {}

  [[nodiscard]] pid_t pid_of(const std::string& name) const {
    if (name.ends_with(".next")) return pipeline_.successor_of(name.substr(0, name.size() - 5));
    const auto pids = pipeline_.pids();
    const auto found = pids.find(name);
    return found == pids.end() ? 0 : found->second;
  }

  /// What was killed, as it was.
  std::map<std::string, pid_t> strike(const OperatorFault& fault) {
    std::map<std::string, pid_t> killed;
    const auto kill_now = [&] {
      const pid_t pid = fault.killed.empty() ? 0 : pid_of(fault.killed);
      if (pid == 0) return;
      ::kill(pid, fault.signal);
      if (!fault.killed.ends_with(".next")) killed[fault.killed] = pid;
    };
    if (fault.verb.empty()) {
      kill_now();
      return killed;
    }
    cli::ChildProcess verb = pipeline_.begin(fault.verb);
    pipeline_.let_pass(fault.after);
    kill_now();
    std::optional<cli::ExitStatus> end;
    std::vector<std::string> lines;
    EXPECT_TRUE(pipeline_.wait_until([&] {
      end = verb.poll_exit();
      for (std::string& line : verb.read_lines(end.has_value())) lines.push_back(std::move(line));
      return end.has_value();
    })) << fault.name()
        << " does not return";
    if (fault.killed.empty() && end) {
      EXPECT_TRUE(end->success()) << fault.name() << testing::PrintToString(lines) << pipeline_.log();
    }
    return killed;
  }
};

TEST_F(OperatorChaos, ThePictureComesBackAndNothingIsLeftBehind) {
  ASSERT_NO_FATAL_FAILURE(begin());
  const ChaosOptions& options = chaos_options();
  OperatorFaults chance(options.seed);
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.seconds * 1e9);
  for (int number = 0; bus::now_ns() < end_ns; ++number) {
    pipeline_.let_pass(chance.pause());
    OperatorFault fault = chance.next();
    for (int k = 0; k < 1000 && fault.name().find(options.only) == std::string::npos; ++k) fault = chance.next();
    ASSERT_NE(fault.name().find(options.only), std::string::npos) << "there is no such fault";
    SCOPED_TRACE("seed " + std::to_string(options.seed) + ", fault " + std::to_string(number) + ": " + fault.name());
    const bool other_sun = fault.name().ends_with("engine");
    const Before before = look();
    const std::int64_t begin_ns = bus::now_ns();
    const auto killed = strike(fault);
    const double lasted_s = static_cast<double>(bus::now_ns() - begin_ns) * 1e-9;
    ASSERT_NO_FATAL_FAILURE(expect_it_comes_back(
        before, killed, other_sun ? std::max(options.loss, kOtherSunLoss) : options.loss, fault.name(), lasted_s));
  }
  for (const char* one : {"streamer=1", "relight=1"}) {
    const cli::Answer answer = pipeline_.operate({"scale", one});
    EXPECT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  }
  expect_a_good_end();
}

}  // namespace
}  // namespace splatbus::chaos

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  splatbus::chaos::chaos_options().seconds = 20;
  splatbus::chaos::parse_chaos_options(argc, argv);
  return RUN_ALL_TESTS();
}
