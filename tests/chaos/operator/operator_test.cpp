// A live pipeline under a turning sun, with two viewers, one of whom walks, which an operator swaps, scales, restarts
// and changes by chance and by seed, while processes die: SPLATBUS_CHAOS_SECONDS (or --seconds) of it,
// SPLATBUS_CHAOS_SEED (or --seed). After each the picture is back; at the end the model is whole, and nothing is left
// that was not there at the start. --only WORD leaves out the faults whose name has it not; --samples FILE writes what
// the pictures were worth all the while.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "../../hostile/budgets.h"
#include "../../integration/pipeline.h"
#include "../pipeline_under_fire.h"
#include "bus/clock.h"
#include "fault.h"

namespace splatbus::chaos {
namespace {

using namespace std::chrono_literals;

double seconds = 20;
std::string only;  // faults whose name has it
std::ofstream samples;
unsigned seed = 1;
/// From a fault's end to a picture as good as before. Long, for machines differ; the figure is printed.
double recover_s = 60;
/// What a picture as good as before may lack. Wide, for training is no constant on a busy machine; the figure is
/// printed.
double loss = 0.05;
/// The same where another engine begins, and its sun with it: that is another picture.
constexpr double kOtherSunLoss = 0.05;

constexpr double kSsim = 0.8;
constexpr std::size_t kGrowth = 160 * hostile::kMiB;  ///< of a process, whose model grows meanwhile
constexpr std::size_t kMoreDescriptors = 48;
constexpr std::size_t kLogBytesAFault = 65536;
/// Rings are made anew, larger, as pictures and models grow.
constexpr double kMoreSlabs = 8;
constexpr std::int64_t kBeforeNs = 6'000'000'000;

/// Of those who look, one orbits and one walks.
std::string launch_file(const std::filesystem::path& folder) {
  const std::string path_file = folder / "walk.txt";
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

class OperatorChaos : public testing::Test {
 protected:
  /// What the picture was worth lately: the lower quartile, for the sun turns and training is no constant.
  [[nodiscard]] double ssim_before() const {
    std::vector<double> lately;
    for (const auto& sample : pipeline_.samples()) {
      if (sample.time_ns > bus::now_ns() - kBeforeNs) lately.push_back(sample.level);
    }
    if (lately.empty()) return kSsim;
    std::ranges::sort(lately);
    return lately[lately.size() / 4];
  }

  /// For the log: what the pictures were before, and have been since.
  [[nodiscard]] std::string said(double before, std::size_t first) const {
    std::string text = "SSIM " + std::to_string(before) + " before; since:";
    for (std::size_t k = first; k < pipeline_.samples().size(); ++k) {
      text += " " + std::to_string(pipeline_.samples()[k].level);
    }
    return text + "\n";
  }

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

  /// Of the model as it is, ascending.
  std::vector<std::uint64_t> whole_model() {
    auto ids = pipeline_.gaussian_ids().value_or(std::vector<std::uint64_t>());
    std::ranges::sort(ids);
    EXPECT_GT(ids.size(), 100U) << pipeline_.log();
    EXPECT_EQ(std::ranges::adjacent_find(ids), ids.end()) << "a Gaussian is there twice";
    EXPECT_FALSE(!ids.empty() && ids.front() == 0) << "nobody's Gaussian";
    return ids;
  }

  /// Share of those before that are there still. Training removes some all the time.
  static double kept(const std::vector<std::uint64_t>& before, const std::vector<std::uint64_t>& now) {
    std::vector<std::uint64_t> both;
    std::ranges::set_intersection(before, now, std::back_inserter(both));
    return static_cast<double>(both.size()) / static_cast<double>(std::max<std::size_t>(1, before.size()));
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
    EXPECT_LT(pipeline_.log_bytes(), log_bytes_ + kLogBytesAFault * static_cast<std::size_t>(faults + 1));
    std::printf("slabs %.0f (%.0f), log %zu bytes\n", after.slabs, before.slabs, pipeline_.log_bytes());
  }

  cli::PrivateBusFolder folder_;
  /// As many as stand around the scene in equal parts: the input cameras follow a viewer who orbits, and what he sees
  /// gets better while what he does not gets worse.
  static constexpr int kViews = 4;
  PipelineUnderFire pipeline_{launch_file(folder_.path()), kViews};
  std::size_t log_bytes_ = 0;
};

TEST_F(OperatorChaos, ThePictureComesBackAndNothingIsLeftBehind) {
  ASSERT_TRUE(pipeline_.wait_until_well(kSsim, {})) << pipeline_.log();
  pipeline_.sample_pictures();
  ASSERT_TRUE(pipeline_.wait_until([&] { return pipeline_.usage().slabs > 0 && pipeline_.samples().size() >= 8; }));
  const Usage before = pipeline_.usage();
  log_bytes_ = pipeline_.log_bytes();
  OperatorFaults chance(seed);
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(seconds * 1e9);
  int faults = 0;
  double slowest_s = 0, least_kept = 1, most_more = 0;
  for (; bus::now_ns() < end_ns; ++faults) {
    pipeline_.let_pass(chance.pause());
    OperatorFault fault = chance.next();
    for (int k = 0; k < 1000 && fault.name().find(only) == std::string::npos; ++k) fault = chance.next();
    ASSERT_NE(fault.name().find(only), std::string::npos) << "there is no such fault";
    SCOPED_TRACE("seed " + std::to_string(seed) + ", fault " + std::to_string(faults) + ": " + fault.name());
    const double ssim = ssim_before();
    const bool other_sun = fault.name().ends_with("engine");
    const double lacking = other_sun ? std::max(loss, kOtherSunLoss) : loss;
    const std::vector<std::uint64_t> ids = whole_model();
    const std::size_t first = pipeline_.samples().size();
    const std::int64_t begin_ns = bus::now_ns();
    const auto killed = strike(fault);
    const std::int64_t struck_ns = bus::now_ns();
    ASSERT_TRUE(pipeline_.wait_until_well(ssim - lacking, killed)) << said(ssim, first) << pipeline_.log();
    const double back_s = static_cast<double>(bus::now_ns() - struck_ns) * 1e-9;
    slowest_s = std::max(slowest_s, back_s);
    const auto least = std::ranges::min_element(pipeline_.samples().begin() + static_cast<std::ptrdiff_t>(first),
                                                pipeline_.samples().end(), {}, &PipelineUnderFire::Sample::level);
    std::printf("%3d  %-56s %5.1f s, back %5.1f s later; SSIM %.4f, least %.4f, then %.4f\n", faults,
                fault.name().c_str(), static_cast<double>(struck_ns - begin_ns) * 1e-9, back_s, ssim,
                least == pipeline_.samples().end() ? pipeline_.ssim() : least->level, pipeline_.ssim());
    std::fflush(stdout);
    EXPECT_LT(back_s, recover_s);
    const std::vector<std::uint64_t> ids_now = whole_model();
    const double part = kept(ids, ids_now);
    std::printf("     %zu Gaussians of %zu, %.4f kept\n", ids_now.size(), ids.size(), part);
    least_kept = std::min(least_kept, part);
    most_more = std::max(most_more, static_cast<double>(ids_now.size()) / static_cast<double>(ids.size()));
  }
  EXPECT_GT(faults, 0);
  for (const auto& sample : pipeline_.samples()) {
    samples << static_cast<double>(sample.time_ns - pipeline_.samples()[0].time_ns) * 1e-9 << " " << sample.level
            << "\n";
  }
  std::printf("%d faults, slowest recovery %.1f s; of the Gaussians at least %.4f kept, at most %.3f times as many\n",
              faults, slowest_s, least_kept, most_more);
  for (const char* one : {"streamer=1", "relight=1"}) {
    const cli::Answer answer = pipeline_.operate({"scale", one});
    EXPECT_TRUE(answer.status.success()) << testing::PrintToString(answer.lines);
  }
  ASSERT_TRUE(pipeline_.wait_until_well(kSsim, {})) << pipeline_.log();
  (void)whole_model();
  expect_nothing_left(before, faults);
  EXPECT_EQ(pipeline_.stop(), std::set<std::string>()) << "it outlives its supervisor";
}

void set_from(const char* text, double& value) {
  if (text != nullptr) value = std::atof(text);
}

}  // namespace

void configure(int argc, char** argv) {
  double seed_number = seed;
  set_from(std::getenv("SPLATBUS_CHAOS_SECONDS"), seconds);
  set_from(std::getenv("SPLATBUS_CHAOS_SEED"), seed_number);
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string option = argv[i];
    if (option == "--seconds") set_from(argv[i + 1], seconds);
    if (option == "--seed") set_from(argv[i + 1], seed_number);
    if (option == "--recover") set_from(argv[i + 1], recover_s);
    if (option == "--only") only = argv[i + 1];
    if (option == "--loss") set_from(argv[i + 1], loss);
    if (option == "--samples") samples.open(argv[i + 1]);
  }
  seed = static_cast<unsigned>(seed_number);
}

}  // namespace splatbus::chaos

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  splatbus::chaos::configure(argc, argv);
  return RUN_ALL_TESTS();
}
