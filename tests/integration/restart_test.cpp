#include <gtest/gtest.h>

#include <algorithm>
#include <csignal>
#include <string>

#include "../unit/services/gateway/wire_client.h"
#include "pipeline.h"

namespace splatbus::cli {
namespace {

constexpr double kSsim = 0.8;

double viewer_counter(const Pipeline& pipeline, const std::string& name) {
  const auto counters = pipeline.status("viewer").counters;
  const auto counter = counters.find(name);
  return counter == counters.end() ? 0 : counter->second;
}

/// Every service dies once; the supervisor brings it back, nobody else notices, and pictures reach the viewer again.
TEST(Restart, AnyServiceKilledComesBackAndThePictureGoesOn) {
  Pipeline pipeline;
  ASSERT_TRUE(pipeline.wait_for_picture(kSsim)) << pipeline.log();
  for (const std::string victim :
       {"viewer", "streamer", "relight", "expander", "engine", "capture-bridge", "trainer", "gateway", "bus"}) {
    SCOPED_TRACE(victim);
    const auto before = pipeline.pids();
    ASSERT_EQ(before.size(), 9U);
    const std::uint64_t gaussians = pipeline.state().trainer.gaussians;
    const std::uint64_t trainer_epoch = pipeline.state().trainer.epoch;
    const bool viewer_is_watched = victim == "trainer" || victim == "streamer" || victim == "engine";
    // Its counters come with its heartbeat, after the first pictures of its new life.
    ASSERT_TRUE(pipeline.wait_until([&] { return viewer_counter(pipeline, "gaussians") > 0; })) << pipeline.log();
    const double frames = viewer_counter(pipeline, "frames");
    const double shown = viewer_counter(pipeline, "gaussians");
    double least_shown = shown;
    ASSERT_EQ(kill(before.at(victim), SIGKILL), 0);
    ASSERT_TRUE(pipeline.wait_until([&] {
      least_shown = std::min(least_shown, viewer_counter(pipeline, "gaussians"));
      const ProcessStatus status = pipeline.status(victim);
      return status.restarts == 1 && status.state == ProcessState::Running;
    })) << pipeline.log();
    ASSERT_TRUE(pipeline.wait_for_picture(kSsim)) << pipeline.log();
    const auto after = pipeline.pids();
    for (const auto& [name, pid] : before) {
      if (name == victim) {
        EXPECT_NE(after.at(name), pid);
      } else {
        EXPECT_EQ(after.at(name), pid) << name << " was restarted too\n" << pipeline.log();
      }
    }
    if (viewer_is_watched) {
      EXPECT_GE(least_shown, shown / 2) << "the viewer's picture went away";
      EXPECT_TRUE(pipeline.wait_until([&] { return viewer_counter(pipeline, "frames") > frames; }))
          << "the viewer draws no more";
    }
    EXPECT_TRUE(pipeline.wait_until([&] {
      return gateway_test::get(pipeline.gateway_port(), "/healthz").status == 200;
    })) << pipeline.log();
    // Its own words, not those of the process before.
    ASSERT_TRUE(pipeline.wait_until([&] {
      const auto& trainer = pipeline.state().trainer;
      return trainer.gaussians > 0 && (victim != "trainer" || trainer.epoch != trainer_epoch);
    })) << pipeline.log();
    EXPECT_GT(pipeline.state().trainer.gaussians, gaussians / 2) << "the model was lost";
  }
}

}  // namespace
}  // namespace splatbus::cli
