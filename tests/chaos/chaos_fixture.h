#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "pipeline_under_fire.h"

namespace splatbus::chaos {

/// What the command line of a chaos test says: --seconds N of faults, --seed N; --recover S and --loss X, the bounds of
/// what a fault may cost; --only WORD leaves out the faults whose name has it not; --samples FILE writes what the
/// pictures were worth all the while.
struct ChaosOptions {
  double seconds = 10;
  unsigned seed = 1;
  /// From a fault's end to pictures as good as before. Long, for machines differ; the figure is printed.
  double recover_s = 60;
  /// What pictures as good as before may lack. Wide, for training is no constant on a busy machine; the figure is
  /// printed.
  double loss = 0.05;
  std::string only;
  std::ofstream samples;
};

ChaosOptions& chaos_options();
void parse_chaos_options(int argc, char** argv);

/// A pipeline to which one thing after the other happens, and what has to hold after each.
class ChaosTest : public testing::Test {
 protected:
  static constexpr double kSsim = 0.8;
  /// As many as stand around the scene in equal parts: the input cameras follow a viewer who orbits, and what he sees
  /// gets better while what he does not gets worse.
  static constexpr int kViews = 4;

  explicit ChaosTest(const std::string& launch_file) : pipeline_(launch_file, kViews) {}

  /// Waits until there are pictures, and what everybody takes.
  void begin();

  /// Before something happens ...
  struct Before {
    double level = 0;
    std::vector<std::uint64_t> ids;
    std::size_t first_sample = 0;
    pid_t trainer = 0;
    std::uint64_t model_epoch = 0;
  };
  [[nodiscard]] Before look();
  /// ... and after it: waits until those that were killed are others and the pictures are worth no more than `loss`
  /// less, looks whether the Gaussians are the same, and prints it all with `name`. `lasted_s`: what happened.
  void expect_it_comes_back(const Before& before, const std::map<std::string, pid_t>& killed, double loss,
                            const std::string& name, double lasted_s);
  /// Of all that happened, and what is left: nothing that was not there at the start.
  void expect_a_good_end();

  PipelineUnderFire pipeline_;

 private:
  /// What the pictures were worth lately, after what happened last was over: the lower quartile, for the sun turns and
  /// training is no constant. Where there are none, what they were to be worth then.
  [[nodiscard]] double level_before() const;
  /// Of the model as it is, ascending.
  std::vector<std::uint64_t> whole_model();
  void expect_nothing_left();

  Usage at_the_start_;
  std::int64_t over_ns_ = 0;
  double level_ = kSsim;
  std::size_t log_bytes_ = 0;
  int faults_ = 0, late_ = 0;
  double slowest_s_ = 0, sum_s_ = 0, least_kept_ = 1, most_more_ = 0;
};

}  // namespace splatbus::chaos
