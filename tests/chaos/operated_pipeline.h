#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <vector>

#include "pipeline_under_fire.h"

namespace splatbus::chaos {

/// A live pipeline that a test operates as a person does.
class OperatedPipeline : public testing::Test {
 protected:
  static constexpr double kSsim = 0.8;

  void start(std::unique_ptr<PipelineUnderFire> pipeline) {
    pipeline_ = std::move(pipeline);
    ASSERT_TRUE(pipeline_->wait_until_well(kSsim, {})) << pipeline_->log();
  }

  void operate(const std::vector<std::string>& verb) {
    const cli::Answer answer = pipeline_->operate(verb);
    ASSERT_TRUE(answer.status.success()) << testing::PrintToString(verb) << testing::PrintToString(answer.lines)
                                         << pipeline_->log();
  }

  /// Another process than before has its name and runs.
  void swap(const std::string& name, const std::vector<std::string>& options = {}) {
    const pid_t before = pipeline_->pids().at(name);
    std::vector<std::string> verb{"swap", name};
    verb.insert(verb.end(), options.begin(), options.end());
    operate(verb);
    EXPECT_TRUE(pipeline_->wait_until([&] { return pipeline_->pids().at(name) != before; })) << name;
  }

  /// No Gaussian is inserted or removed from now on, by later trainers either. The viewer stands still: the input
  /// cameras follow it, and the picture that is compared gets better and worse as they come and go.
  void only_train() {
    operate({"param", "set", "viewer", "path", "still"});
    operate({"stop", "expander"});
    for (const char* off : {"carve", "prune", "densify", "freeze"}) {
      operate({"param", "set", "trainer", off, "false", "--save"});
    }
  }

  std::vector<std::uint64_t> sorted_ids() {
    auto ids = pipeline_->gaussian_ids().value_or(std::vector<std::uint64_t>());
    std::ranges::sort(ids);
    return ids;
  }

  std::unique_ptr<PipelineUnderFire> pipeline_;
};

}  // namespace splatbus::chaos
