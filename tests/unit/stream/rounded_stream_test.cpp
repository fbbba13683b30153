// What is held where values are rounded to what shows.
#include <gtest/gtest.h>

#include <cstdlib>

#include "expectations.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::ToyServer;

constexpr float kCoarseness = 3;

StreamOptions rounded() {
  StreamOptions options;
  options.coarseness = kCoarseness;
  return options;
}

/// Calls visit(attribute, held value, target's, shift that its class allows) for all that is delta coded.
template <class Visit>
void for_each_value(const ToyServer& server, const Visit& visit) {
  const ReplicatedState& held = server.stream.held();
  const QuantizedGaussians& target = server.stream.observed_gaussians();
  std::map<std::uint64_t, std::uint32_t> column_of;
  for (std::uint32_t i = 0; i < target.count(); ++i) column_of[target.gaussian_id[i]] = i;
  const Precision precision(held.layout, kCoarseness);
  for (const auto& [number, page] : held.pages) {
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const std::uint32_t row = page.row(lane), column = column_of.at(held.gaussians.gaussian_id[row]);
      const Precision::Class of = precision.of(target, column);
      for (std::size_t k = 0; k < held.layout.attributes().size(); ++k) {
        const AttributeChannels& a = held.layout.attributes()[k];
        if (a.attribute == Attribute::Visibility) continue;
        for (int c = a.first; c < a.first + a.channels; ++c) {
          visit(a, held.gaussians.channels[c][row], target.channels[c][column], precision.shift(k, of));
        }
      }
    }
  }
}

TEST(RoundedStream, WhatIsOfferedIsRoundedAndThenRests) {
  ToyServer server(1, 600, Appearance::Transfer, rounded());
  std::size_t coarse = 0, values = 0;
  for_each_value(server, [&](const AttributeChannels& a, std::int32_t held, std::int32_t target, int shift) {
    ++values;
    coarse += shift > 0 ? 1 : 0;
    ASSERT_EQ(held % (1 << shift), 0) << wire::EnumNameAttribute(a.attribute);
    const std::int32_t most = held + (1 << shift) > a.maximum ? (1 << shift) - 1 : (1 << shift) / 2;
    ASSERT_LE(std::abs(held - target), most) << wire::EnumNameAttribute(a.attribute);
  });
  EXPECT_GT(coarse, values / 5);
  for (int tick = 0; tick < 12; ++tick) EXPECT_TRUE(server.tick().empty()) << "tick " << tick;
}

TEST(RoundedStream, FollowsTheModelBitForBitAndToWithinAStepOfItsOwn) {
  for (const Appearance appearance : {Appearance::Transfer, Appearance::Radiance}) {
    ToyServer server(2, 1500, appearance, rounded());
    Schedules schedules = default_schedules();
    for (AttributeSchedule& schedule : schedules) schedule.every = 1;  // what rests has rested for fewer ticks
    server.stream.set_schedules(schedules);
    test::ShownReplica replica;
    join(server.stream, replica);
    for (int tick = 0; tick < 10; ++tick) {
      if (tick % 4 == 1) server.insert(40);
      if (tick % 4 == 3) server.remove(30);
      server.train(0.02F);
      server.tick_for(replica);
      test::expect_exact(server.stream, replica);
    }
    for (int tick = 0; tick < 14; ++tick) server.tick_for(replica);
    test::expect_exact(server.stream, replica);
    for_each_value(server, [&](const AttributeChannels& a, std::int32_t held, std::int32_t target, int shift) {
      // What has never changed its class is off by half of what it is rounded to, what rests by one more step.
      if (a.attribute == Attribute::Normal) return;
      ASSERT_LE(std::abs(held - target), 1 << shift) << wire::EnumNameAttribute(a.attribute) << " by 2^" << shift;
    });
    EXPECT_TRUE(server.tick().empty());
  }
}

TEST(RoundedStream, TakesFewerBytes) {
  const auto bytes = [](const StreamOptions& options) {
    ToyServer server(3, 1024, Appearance::Transfer, options);
    return static_cast<double>(server.stream.page_packets(0)[0].packet.bytes());
  };
  EXPECT_LT(bytes(rounded()), 0.85 * bytes({}));
  StreamOptions draco;
  draco.codec = PageCodec::Draco;
  EXPECT_LT(bytes({}), 0.95 * bytes(draco));
}

}  // namespace
}  // namespace splatbus::stream
