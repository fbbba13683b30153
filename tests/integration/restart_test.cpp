#include <gtest/gtest.h>

#include <csignal>
#include <string>

#include "pipeline.h"

namespace splatbus::cli {
namespace {

constexpr double kSsim = 0.8;

/// Every service dies once; the supervisor brings it back, nobody else notices, and pictures reach the viewer again.
TEST(Restart, AnyServiceKilledComesBackAndThePictureGoesOn) {
  Pipeline pipeline;
  ASSERT_TRUE(pipeline.wait_for_picture(kSsim)) << pipeline.log();
  for (const std::string victim :
       {"viewer", "streamer", "relight", "expander", "engine", "capture-bridge", "trainer", "bus"}) {
    SCOPED_TRACE(victim);
    const auto before = pipeline.pids();
    ASSERT_EQ(before.size(), 8U);
    const std::uint64_t gaussians = pipeline.state().trainer.gaussians;
    ASSERT_EQ(kill(before.at(victim), SIGKILL), 0);
    ASSERT_TRUE(pipeline.wait_until([&] {
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
    ASSERT_TRUE(pipeline.wait_until([&] { return pipeline.state().trainer.gaussians > 0; }));
    EXPECT_GT(pipeline.state().trainer.gaussians, gaussians / 2) << "the model was lost";
  }
}

}  // namespace
}  // namespace splatbus::cli
