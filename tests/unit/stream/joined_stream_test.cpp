// A streamer that goes on with another one's stream.
#include <algorithm>

#include "toy_server.h"

namespace splatbus::stream {
namespace {

class JoinedStream : public testing::Test {
 protected:
  void begin() {
    ASSERT_TRUE(server_.stream.observe(server_.model().view()));
    server_.stream.reset_to_target();
  }
  [[nodiscard]] std::uint32_t least_version() const {
    return std::ranges::min_element(*server_.stream.offered(), {}, &OfferedPage::version)->version;
  }
  [[nodiscard]] std::uint32_t newest_version() const {
    return std::ranges::max_element(*server_.stream.offered(), {}, &OfferedPage::version)->version;
  }
  test::ToyServer server_{5, 3000};
  const StreamModel::Status before_ = server_.stream.status();
};

TEST_F(JoinedStream, HasItsEpochItsStepAndVersionsBeyond) {
  const StreamOrigin origin{
      .epoch = 5000, .layout = before_.layout, .mean_step = before_.mean_step / 2, .version = 10'000};
  server_.stream.join(origin);
  EXPECT_FALSE(server_.stream.ready());
  begin();
  const StreamModel::Status now = server_.stream.status();
  EXPECT_EQ(now.epoch, origin.epoch);
  EXPECT_EQ(now.mean_step, origin.mean_step);
  EXPECT_EQ(now.gaussians, before_.gaussians);
  EXPECT_GT(least_version(), origin.version);
  // A viewer of it shows what is there, in steps of that size.
  Replica replica;
  test::join(server_.stream, replica);
  EXPECT_EQ(replica.epoch(), origin.epoch);
  EXPECT_EQ(replica.held().layout.at(Attribute::Mean).quantizer.step, origin.mean_step);
  EXPECT_EQ(replica.count(), server_.model().count());
}

TEST_F(JoinedStream, ThatWasLeftGoesOnWithItsVersions) {
  const StreamOrigin origin{.epoch = 5000, .layout = before_.layout, .mean_step = before_.mean_step, .version = 100};
  server_.stream.join(origin);
  begin();
  const std::uint32_t newest = newest_version();
  server_.stream.join(origin);
  begin();
  EXPECT_GT(least_version(), newest) << "none is used again";
}

TEST_F(JoinedStream, IsItsOwnAgainAfterAnotherReset) {
  server_.stream.join({.epoch = 5000, .layout = before_.layout, .mean_step = before_.mean_step, .version = 0});
  begin();
  server_.stream.release();
  begin();
  EXPECT_EQ(server_.stream.status().epoch, before_.epoch + 1);
}

TEST_F(JoinedStream, OfAnotherLayoutIsNotJoined) {
  const ParameterLayout other{.appearance = Appearance::Radiance, .sh_degree = 1};
  ASSERT_NE(before_.layout.appearance, other.appearance);
  server_.stream.join({.epoch = 5000, .layout = other, .mean_step = before_.mean_step / 2, .version = 10'000});
  begin();
  const StreamModel::Status now = server_.stream.status();
  EXPECT_EQ(now.epoch, before_.epoch + 1);
  EXPECT_EQ(now.mean_step, before_.mean_step);
}

TEST_F(JoinedStream, RaisedVersionsAreThoseOfWhatChangesFromThenOn) {
  server_.stream.raise_version(7'000);
  server_.train(0.02F);
  ASSERT_TRUE(server_.stream.observe(server_.model().view()));
  server_.stream.make_tick(1e9, {});
  EXPECT_GT(newest_version(), 7'000U);
  const std::uint32_t newest = server_.stream.status().version;
  server_.stream.raise_version(10);
  EXPECT_EQ(server_.stream.status().version, newest) << "and never lower";
}

}  // namespace
}  // namespace splatbus::stream
