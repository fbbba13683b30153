#include "chaos_fixture.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <iterator>

#include "../hostile/budgets.h"
#include "bus/clock.h"

namespace splatbus::chaos {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kGrowth = 160 * hostile::kMiB;  ///< of a process, whose model grows meanwhile
constexpr std::size_t kMoreDescriptors = 48;
constexpr std::size_t kLogBytesAFault = 65536;
/// Rings are made anew, larger, as pictures and models grow.
constexpr double kMoreSlabs = 8;
constexpr std::int64_t kBeforeNs = 6'000'000'000;
constexpr std::size_t kLeastSamples = 4;  // of four views each, to compare with
/// Of the Gaussians before a fault. Training removes some all the time, and as many as it likes while a fault lasts.
constexpr double kKept = 0.9, kMore = 1.5;

/// Share of those before that are there still.
double kept(const std::vector<std::uint64_t>& before, const std::vector<std::uint64_t>& now) {
  std::vector<std::uint64_t> both;
  std::ranges::set_intersection(before, now, std::back_inserter(both));
  return static_cast<double>(both.size()) / static_cast<double>(std::max<std::size_t>(1, before.size()));
}

}  // namespace

ChaosOptions& chaos_options() {
  static ChaosOptions options;
  return options;
}

void parse_chaos_options(int argc, char** argv) {
  ChaosOptions& options = chaos_options();
  const std::map<std::string, double*> numbers{
      {"--seconds", &options.seconds}, {"--recover", &options.recover_s}, {"--loss", &options.loss}};
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string option = argv[i];
    if (const auto number = numbers.find(option); number != numbers.end()) *number->second = std::atof(argv[i + 1]);
    if (option == "--seed") options.seed = static_cast<unsigned>(std::atoi(argv[i + 1]));
    if (option == "--only") options.only = argv[i + 1];
    if (option == "--samples") options.samples.open(argv[i + 1]);
  }
}

void ChaosTest::begin() {
  ASSERT_TRUE(pipeline_.wait_until_well(kSsim, {})) << pipeline_.log();
  pipeline_.sample_pictures();
  ASSERT_TRUE(pipeline_.wait_until([&] {
    return pipeline_.usage().slabs > 0 && pipeline_.samples().size() >= std::size_t{8} * kViews;
  })) << pipeline_.log();
  level_ = pipeline_.samples().back().level;
  at_the_start_ = pipeline_.usage();
  log_bytes_ = pipeline_.log_bytes();
}

double ChaosTest::level_before() const {
  std::vector<double> lately;
  for (const auto& sample : pipeline_.samples()) {
    if (sample.time_ns > std::max(over_ns_, bus::now_ns() - kBeforeNs)) lately.push_back(sample.level);
  }
  if (lately.empty()) return level_;
  std::ranges::sort(lately);
  return lately[lately.size() / 4];
}

std::vector<std::uint64_t> ChaosTest::whole_model() {
  auto ids = pipeline_.gaussian_ids().value_or(std::vector<std::uint64_t>());
  std::ranges::sort(ids);
  EXPECT_GT(ids.size(), 100U) << pipeline_.log();
  EXPECT_EQ(std::ranges::adjacent_find(ids), ids.end()) << "a Gaussian is there twice";
  EXPECT_FALSE(!ids.empty() && ids.front() == 0) << "nobody's Gaussian";
  return ids;
}

ChaosTest::Before ChaosTest::look() {
  // A single picture may be a lucky one.
  (void)pipeline_.wait_until([&] {
    const auto& samples = pipeline_.samples();
    return samples.size() >= kLeastSamples && samples[samples.size() - kLeastSamples].time_ns > over_ns_;
  });
  level_ = level_before();
  return {.level = level_,
          .ids = whole_model(),
          .first_sample = pipeline_.samples().size(),
          .trainer = pipeline_.pids().at("trainer"),
          .model_epoch = pipeline_.model_epoch()};
}

void ChaosTest::expect_it_comes_back(const Before& before, const std::map<std::string, pid_t>& killed, double loss,
                                     const std::string& name, double lasted_s) {
  const std::int64_t over_ns = bus::now_ns();
  if (!pipeline_.wait_until_well(before.level - loss, killed)) {
    std::string text = "SSIM " + std::to_string(before.level) + " before; since:";
    for (std::size_t k = before.first_sample; k < pipeline_.samples().size(); ++k) {
      text += " " + std::to_string(pipeline_.samples()[k].level);
    }
    FAIL() << text << "\n" << pipeline_.log();
  }
  const double back_s = static_cast<double>(bus::now_ns() - over_ns) * 1e-9;
  // Else the old one's model is there still, for whoever has it.
  ASSERT_TRUE(pipeline_.wait_until([&] {
    return pipeline_.pids().at("trainer") == before.trainer || pipeline_.model_epoch() != before.model_epoch;
  })) << "another trainer has published nothing\n"
      << pipeline_.log();
  pipeline_.let_pass(100ms);
  double least = pipeline_.ssim();
  for (std::size_t k = before.first_sample; k < pipeline_.samples().size(); ++k) {
    least = std::min(least, pipeline_.samples()[k].level);
  }
  const std::vector<std::uint64_t> ids = whole_model();
  const double part = kept(before.ids, ids);
  const double more =
      static_cast<double>(ids.size()) / static_cast<double>(std::max<std::size_t>(1, before.ids.size()));
  std::printf("%3d  %-56s %5.1f s, back %5.1f s later; SSIM %.4f, least %.4f, then %.4f; %zu Gaussians, %.4f kept\n",
              faults_, name.c_str(), lasted_s, back_s, before.level, least, pipeline_.ssim(), ids.size(), part);
  std::fflush(stdout);
  EXPECT_LT(back_s, chaos_options().recover_s);
  EXPECT_GT(part, kKept) << "Gaussians were lost";
  EXPECT_LT(more, kMore) << "there are more of them than can have come";
  over_ns_ = bus::now_ns();
  ++faults_;
  late_ += back_s > chaos_options().recover_s ? 1 : 0;
  sum_s_ += back_s;
  slowest_s_ = std::max(slowest_s_, back_s);
  least_kept_ = std::min(least_kept_, part);
  most_more_ = std::max(most_more_, more);
}

void ChaosTest::expect_a_good_end() {
  EXPECT_GT(faults_, 0);
  for (const auto& sample : pipeline_.samples()) {
    chaos_options().samples << static_cast<double>(sample.time_ns - pipeline_.samples()[0].time_ns) * 1e-9 << " "
                            << sample.level << "\n";
  }
  std::printf(
      "%d faults, %d of them late; back after %.2f s in the mean, %.1f s at most; of the Gaussians at least "
      "%.4f kept, at most %.3f times as many\n",
      faults_, late_, sum_s_ / std::max(1, faults_), slowest_s_, least_kept_, most_more_);
  (void)whole_model();
  EXPECT_TRUE(pipeline_.wait_until_well(kSsim, {})) << pipeline_.log();
  expect_nothing_left();
  EXPECT_EQ(pipeline_.stop(), std::set<std::string>()) << "it outlives its supervisor";
}

void ChaosTest::expect_nothing_left() {
  EXPECT_TRUE(pipeline_.wait_until([&] { return pipeline_.usage().slabs <= at_the_start_.slabs + kMoreSlabs; }))
      << pipeline_.usage().slabs << " slabs, " << at_the_start_.slabs << " at the start";
  const Usage after = pipeline_.usage();
  for (const auto& [name, bytes] : after.resident_bytes) {
    std::printf("%-16s %4zu MiB (%4zu at the start), %3zu descriptors (%3zu)\n", name.c_str(), bytes / hostile::kMiB,
                at_the_start_.resident_bytes.at(name) / hostile::kMiB, after.descriptors.at(name),
                at_the_start_.descriptors.at(name));
    EXPECT_LT(bytes, at_the_start_.resident_bytes.at(name) + kGrowth) << name;
    EXPECT_LT(after.descriptors.at(name), at_the_start_.descriptors.at(name) + kMoreDescriptors) << name;
  }
  EXPECT_LT(pipeline_.log_bytes(), log_bytes_ + kLogBytesAFault * static_cast<std::size_t>(faults_ + 1));
  std::printf("slabs %.0f (%.0f), log %zu bytes\n", after.slabs, at_the_start_.slabs, pipeline_.log_bytes());
}

}  // namespace splatbus::chaos
