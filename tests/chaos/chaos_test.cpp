// A live pipeline whose processes are killed and stopped, by chance and by seed: --seconds N of faults, --seed N. After
// each the picture is back; at the end the model is whole, and nothing is left that was not there at the start.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include "../hostile/budgets.h"
#include "bus/clock.h"
#include "pipeline_under_fire.h"

namespace splatbus::chaos {
namespace {

using namespace std::chrono_literals;

double seconds = 10;
unsigned seed = 1;

constexpr double kSsim = 0.8;
constexpr std::size_t kGrowth = 160 * hostile::kMiB;  ///< of a process, whose model grows meanwhile
constexpr std::size_t kMoreDescriptors = 48;
constexpr std::size_t kLogBytesAFault = 65536;
/// Rings are made anew, larger, as pictures and models grow.
constexpr double kMoreSlabs = 8;

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

class Chaos : public testing::Test {
 protected:
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

  void expect_a_whole_model() {
    auto ids = pipeline_.gaussian_ids();
    ASSERT_TRUE(ids.has_value()) << pipeline_.log();
    ASSERT_GT(ids->size(), 100U);
    std::ranges::sort(*ids);
    EXPECT_EQ(std::ranges::adjacent_find(*ids), ids->end()) << "a Gaussian is there twice";
    EXPECT_NE(ids->front(), 0U) << "nobody's Gaussian";
  }

  void expect_nothing_left(const Usage& before, int faults) {
    EXPECT_TRUE(pipeline_.wait_until([&] { return pipeline_.usage().slabs <= before.slabs + kMoreSlabs; }))
        << pipeline_.usage().slabs << " slabs, " << before.slabs << " at the start";
    const Usage after = pipeline_.usage();
    for (const auto& [name, bytes] : after.resident_bytes) {
      std::printf("%-16s %4zu MiB (%4zu at the start), %3zu descriptors (%3zu)\n", name.c_str(), bytes / hostile::kMiB,
                  before.resident_bytes.at(name) / hostile::kMiB, after.descriptors.at(name),
                  before.descriptors.at(name));
      EXPECT_LT(bytes, before.resident_bytes.at(name) + kGrowth) << name;
      EXPECT_LT(after.descriptors.at(name), before.descriptors.at(name) + kMoreDescriptors) << name;
    }
    EXPECT_EQ(after.files, before.files) << "in the bus's folder";
    EXPECT_LT(pipeline_.log_bytes(), log_bytes_ + kLogBytesAFault * static_cast<std::size_t>(faults + 1));
    std::printf("slabs %.0f (%.0f), log %zu bytes\n", after.slabs, before.slabs, pipeline_.log_bytes());
  }

  PipelineUnderFire pipeline_;
  std::size_t log_bytes_ = 0;
};

TEST_F(Chaos, ThePictureComesBackAndNothingIsLeftBehind) {
  ASSERT_TRUE(pipeline_.wait_until_well(kSsim, {})) << pipeline_.log();
  ASSERT_TRUE(pipeline_.wait_until([&] { return pipeline_.usage().slabs > 0; }));
  const Usage before = pipeline_.usage();
  const double ssim = pipeline_.ssim();
  log_bytes_ = pipeline_.log_bytes();
  std::mt19937_64 random(seed);
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(seconds * 1e9);
  int faults = 0;
  for (; bus::now_ns() < end_ns; ++faults) {
    const Fault fault = choose(random);
    SCOPED_TRACE("seed " + std::to_string(seed) + ", fault " + std::to_string(faults) + ": " + fault.name);
    const std::uint64_t gaussians = pipeline_.state().trainer.gaussians;
    const std::uint64_t epoch = pipeline_.state().trainer.epoch;
    const bool all = hits(fault, PipelineUnderFire::kSupervisor);
    const std::int64_t begin_ns = bus::now_ns();
    const auto killed = strike(fault);
    const std::int64_t struck_ns = bus::now_ns();
    if (all) {
      ASSERT_TRUE(pipeline_.start_again()) << pipeline_.log();
    }
    ASSERT_TRUE(pipeline_.wait_until_well(kSsim, all ? std::map<std::string, pid_t>() : killed)) << pipeline_.log();
    std::printf("%3d  %-40s %5.1f s, well %5.1f s later, SSIM %.4f (%.4f at the start)\n", faults, fault.name.c_str(),
                static_cast<double>(struck_ns - begin_ns) * 1e-9, static_cast<double>(bus::now_ns() - struck_ns) * 1e-9,
                pipeline_.ssim(), ssim);
    std::fflush(stdout);
    // Slabs die with the bus and their owner, both at once; else the model is what it was.
    const bool lost = all || (hits(fault, "bus") && hits(fault, "trainer"));
    ASSERT_TRUE(pipeline_.wait_until([&] {
      const auto& trainer = pipeline_.state().trainer;
      return trainer.gaussians > 0 && (!(hits(fault, "trainer") || all) || trainer.epoch != epoch);
    })) << pipeline_.log();
    if (!lost) {
      EXPECT_GT(pipeline_.state().trainer.gaussians, gaussians / 2) << "the model was lost";
    }
    pipeline_.let_pass(std::chrono::milliseconds(random() % 3000));
  }
  EXPECT_GT(faults, 0);
  expect_a_whole_model();
  expect_nothing_left(before, faults);
  EXPECT_EQ(pipeline_.stop(), std::set<std::string>()) << "it outlives its supervisor";
}

}  // namespace
}  // namespace splatbus::chaos

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--seconds") splatbus::chaos::seconds = std::atof(argv[i + 1]);
    if (std::string(argv[i]) == "--seed") splatbus::chaos::seed = static_cast<unsigned>(std::atoi(argv[i + 1]));
  }
  return RUN_ALL_TESTS();
}
