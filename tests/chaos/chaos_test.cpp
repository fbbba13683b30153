// A live pipeline whose processes are killed and stopped, by chance and by seed: see ChaosOptions. Its world is kept in
// a folder, for slabs die with the bus and their owner. After each the pictures are back, and the Gaussians are the
// same; at the end nothing is left that was not there at the start.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <random>

#include "../integration/pipeline.h"
#include "bus/clock.h"
#include "chaos_fixture.h"

namespace splatbus::chaos {
namespace {

using namespace std::chrono_literals;

struct Fault {
  std::string name;
  std::vector<std::string> killed, stopped;
  std::chrono::milliseconds stopped_for{0};
};

/// What happens next: mostly one service killed or stopped, now and then two, or whoever looks after them all.
Fault choose(std::mt19937_64& random) {
  static const std::vector<std::string> services{"bus",     "engine",   "capture-bridge", "expander", "trainer",
                                                 "relight", "streamer", "viewer",         "gateway"};
  const auto one = [&] { return services[random() % services.size()]; };
  Fault fault;
  const auto kind = random() % 16;
  if (kind < 7) {
    fault.killed = {one()};
  } else if (kind < 9) {
    fault.killed = {one(), one()};
  } else if (kind < 13) {
    fault.stopped = {one()};
  } else if (kind == 13) {
    fault.stopped = {one()};
    fault.killed = {one()};
  } else if (kind == 14) {
    fault.stopped = {PipelineUnderFire::kSupervisor};
    fault.killed = {one()};
  } else {
    fault.killed = {PipelineUnderFire::kSupervisor};
  }
  // Some beyond the time after which a supervisor takes a process for hung.
  fault.stopped_for = std::chrono::milliseconds(random() % 5 == 0 ? 7000 : 200 + random() % 2300);
  for (const auto* names : {&fault.killed, &fault.stopped}) {
    for (const std::string& name : *names) fault.name += (names == &fault.killed ? "kill " : "stop ") + name + " ";
  }
  return fault;
}

bool hits(const Fault& fault, const std::string& name) {
  return std::ranges::count(fault.killed, name) > 0;
}

std::string launch_file() {
  static const cli::PrivateBusFolder folder;
  return "world: " + (folder.path() / "world").string() + "\n" + cli::Pipeline::launch_file();
}

class Chaos : public ChaosTest {
 protected:
  Chaos() : ChaosTest(launch_file()) {}

  /// What it killed, as they were.
  std::map<std::string, pid_t> strike(const Fault& fault) {
    const auto pids = pipeline_.pids();
    std::map<std::string, pid_t> killed;
    for (const std::string& name : fault.stopped) ::kill(pids.at(name), SIGSTOP);
    for (const std::string& name : fault.killed) {
      ::kill(pids.at(name), SIGKILL);
      killed[name] = pids.at(name);
    }
    if (!fault.stopped.empty()) pipeline_.let_pass(fault.stopped_for);
    for (const std::string& name : fault.stopped) ::kill(pids.at(name), SIGCONT);
    return killed;
  }
};

TEST_F(Chaos, ThePictureComesBackAndNothingIsLeftBehind) {
  ASSERT_NO_FATAL_FAILURE(begin());
  const std::set<std::string> files = pipeline_.usage().files;
  const ChaosOptions& options = chaos_options();
  std::mt19937_64 random(options.seed);
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.seconds * 1e9);
  for (int number = 0; bus::now_ns() < end_ns; ++number) {
    Fault fault = choose(random);
    for (int k = 0; k < 1000 && fault.name.find(options.only) == std::string::npos; ++k) fault = choose(random);
    ASSERT_NE(fault.name.find(options.only), std::string::npos) << "there is no such fault";
    SCOPED_TRACE("seed " + std::to_string(options.seed) + ", fault " + std::to_string(number) + ": " + fault.name);
    const bool all = hits(fault, PipelineUnderFire::kSupervisor);
    const Before before = look();
    const std::int64_t begin_ns = bus::now_ns();
    const auto killed = strike(fault);
    const double lasted_s = static_cast<double>(bus::now_ns() - begin_ns) * 1e-9;
    if (all) {
      ASSERT_TRUE(pipeline_.start_again()) << pipeline_.log();
    }
    ASSERT_NO_FATAL_FAILURE(expect_it_comes_back(before, all ? std::map<std::string, pid_t>() : killed, options.loss,
                                                 fault.name, lasted_s));
    pipeline_.let_pass(std::chrono::milliseconds(random() % 3000));
  }
  EXPECT_EQ(pipeline_.usage().files, files) << "in the bus's folder";
  expect_a_good_end();
}

}  // namespace
}  // namespace splatbus::chaos

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  splatbus::chaos::parse_chaos_options(argc, argv);
  return RUN_ALL_TESTS();
}
