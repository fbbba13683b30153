#include "stream/stream_model.h"

#include <gtest/gtest.h>

#include <limits>
#include <map>

#include "expectations.h"
#include "shown_replica.h"
#include "stream/delta_selection.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::join;
using test::parse;
using test::send;
using test::ToyServer;

std::size_t bytes(const std::vector<EncodedPacket>& packets) {
  std::size_t sum = 0;
  for (const EncodedPacket& packet : packets) sum += packet.bytes();
  return sum;
}

std::size_t count(const std::vector<EncodedPacket>& packets, wire::Body body) {
  return static_cast<std::size_t>(std::ranges::count(packets, body, &EncodedPacket::body));
}

TEST(StreamModel, NothingIsSentWhenNothingChanges) {
  ToyServer server(1);
  for (int tick = 0; tick < 5; ++tick) EXPECT_TRUE(server.tick().empty());
}

TEST(StreamModel, JitterBelowTheDeadZoneIsNeverSent) {
  ToyServer server(2);
  const GaussiansBuffer rest = GaussiansBuffer::copy_of(server.model().view());
  std::mt19937 random(4);
  std::size_t packets = 0;
  for (int tick = 0; tick < 60; ++tick) {
    // Half a step of the albedo's quantizer, to and fro.
    for (std::size_t i = 0; i < rest.count(); ++i) {
      const float jitter = random() % 2 ? 0.5F : -0.5F;
      for (int c = 0; c < 3; ++c) {
        const std::size_t at = static_cast<std::size_t>(ParameterLayout::kAlbedo + c) * rest.stride() + i;
        server.model().parameters[at] = linear_from_srgb(srgb_from_linear(rest.parameters[at]) + jitter / 255);
      }
    }
    packets += server.tick().size();
  }
  EXPECT_EQ(packets, 0U);
}

TEST(StreamModel, WhatHasConvergedIsSentToWithinAStepAndThenRests) {
  ToyServer server(3);
  test::ShownReplica replica;
  join(server.stream, replica);
  Schedules schedules = default_schedules();
  schedules[static_cast<std::size_t>(Attribute::Albedo)].dead_zone = 2;
  server.stream.set_schedules(schedules);
  // Two steps of albedo: inside the dead zone.
  for (std::size_t i = 0; i < server.model().count(); ++i) {
    float& red =
        server.model().parameters[static_cast<std::size_t>(ParameterLayout::kAlbedo) * server.model().stride() + i];
    red = linear_from_srgb(srgb_from_linear(red) + 2.0F / 255);
  }
  std::size_t first = 0, later = 0;
  for (int tick = 0; tick < 8; ++tick) {
    const auto packets = server.tick();
    first += count(packets, wire::Body::PageDelta);
    send(packets, replica);
  }
  EXPECT_EQ(first, 0U) << "sent before it had rested";
  for (int tick = 0; tick < 4; ++tick) server.tick_for(replica);
  for (int tick = 0; tick < 20; ++tick) later += server.tick().size();
  EXPECT_EQ(later, 0U);
  const AttributeChannels& albedo = replica.held().layout.at(Attribute::Albedo);
  test::for_each_held(server, replica, [&](std::uint64_t id, std::uint32_t row) {
    const float want = srgb_from_linear(
        server.model()
            .parameters[static_cast<std::size_t>(ParameterLayout::kAlbedo) * server.model().stride() + id - 1]);
    EXPECT_NEAR(static_cast<float>(replica.held().gaussians.channels[albedo.first][row]) / 255, want, 1.6F / 255);
  });
}

TEST(StreamModel, WhatRestsKeepsItsRestWhenOthersAreRemoved) {
  ToyServer server(20, 600);
  Schedules schedules = default_schedules();
  schedules[static_cast<std::size_t>(Attribute::Albedo)].dead_zone = 2;
  server.stream.set_schedules(schedules);
  for (std::size_t i = 0; i < server.model().count(); ++i) {
    float& red =
        server.model().parameters[static_cast<std::size_t>(ParameterLayout::kAlbedo) * server.model().stride() + i];
    red = linear_from_srgb(srgb_from_linear(red) + 2.0F / 255);
  }
  for (int tick = 0; tick < 4; ++tick) EXPECT_TRUE(server.tick().empty());
  server.remove(40);
  EXPECT_EQ(count(server.tick(), wire::Body::PageDelta), 1U) << "the removal";
  std::size_t deltas = 0;
  for (int tick = 5; tick < 10; ++tick) deltas += count(server.tick(), wire::Body::PageDelta);
  EXPECT_GT(deltas, 0U);
  for (int tick = 10; tick < 20; ++tick) EXPECT_TRUE(server.tick().empty()) << "tick " << tick;
}

TEST(StreamModel, BudgetBoundsEveryTickAndEverythingArrivesInTheEnd) {
  ToyServer server(5, 900);
  test::ShownReplica replica;
  join(server.stream, replica);
  server.insert(124);
  server.train(0.05F);
  std::size_t ticks = 0;
  constexpr std::size_t kBudget = 2'500;
  for (; ticks < 200; ++ticks) {
    const auto packets = server.tick(kBudget);
    send(packets, replica);
    EXPECT_LT(bytes(packets), kBudget * 5 / 4 + (ticks == 0 ? 3000 : 0)) << "tick " << ticks;
    if (server.stream.unsent() == 0 && server.stream.pending_deltas() == 0 && packets.empty()) break;
  }
  EXPECT_GT(ticks, 5U);
  EXPECT_LT(ticks, 200U);
  EXPECT_EQ(replica.count(), 1024U);
}

TEST(StreamModel, DeltasOfWhatIsSeenComeFirst) {
  ToyServer server(16, 4000);
  const Camera camera = look_at({-2.5F, 1, 0}, {-2, 0, 0}, 64, 64, 0.8F);
  const HeldGaussians before = server.stream.held().gaussians;
  const std::size_t rows = before.count();
  for (std::size_t i = 0; i < server.model().count(); ++i) {
    server.model().parameters[static_cast<std::size_t>(ParameterLayout::kAlbedo) * server.model().stride() + i] += 0.1F;
  }
  ASSERT_TRUE(server.stream.observe(server.model().view()));
  server.stream.make_tick(300, {&camera, 1});
  ASSERT_GE(count(test::packets_of(server.stream), wire::Body::PageDelta), 1U);
  std::map<std::uint64_t, std::size_t> column;
  for (std::size_t i = 0; i < server.model().count(); ++i) column[server.model().gaussian_id[i]] = i;
  const auto seen = [&](std::size_t slot) {
    const GaussiansView view = server.model().view();
    const std::size_t i = column.at(before.gaussian_id[slot]);
    const glm::vec3 pixel = project(camera, {view.plane(0)[i], view.plane(1)[i], view.plane(2)[i]});
    return pixel.z > 0 && std::abs(pixel.x - 32) < 40 && std::abs(pixel.y - 32) < 40;
  };
  std::size_t sent = 0, sent_and_seen = 0, all_seen = 0;
  const int red = server.stream.held().layout.at(Attribute::Albedo).first;
  for (std::size_t slot = 0; slot < rows; ++slot) {
    if (before.gaussian_id[slot] == 0) continue;
    all_seen += seen(slot) ? 1 : 0;
    if (server.stream.held().gaussians.channels[red][slot] == before.channels[red][slot]) continue;
    ++sent;
    sent_and_seen += seen(slot) ? 1 : 0;
  }
  ASSERT_LT(all_seen, 2000U);
  ASSERT_GT(sent, 50U);
  ASSERT_GT(all_seen, sent);
  EXPECT_GE(sent_and_seen, sent * 95 / 100) << "of " << sent;
}

TEST(StreamModel, OfAModelThatIsLargerThanViewersTakeAPartIsServed) {
  const StreamOptions options{.max_gaussians = 1000};
  ToyServer server(17, 600, Appearance::Transfer, options);
  test::ShownReplica replica(1000);
  join(server.stream, replica);
  server.insert(900);
  for (int tick = 0; tick < 3; ++tick) server.tick_for(replica);
  EXPECT_EQ(replica.count(), 1000U);
  EXPECT_TRUE(server.stream.full());
  EXPECT_EQ(server.stream.unsent(), 500U);
  server.remove(300);
  for (int tick = 0; tick < 3; ++tick) server.tick_for(replica);
  EXPECT_EQ(replica.count(), 1000U);
  server.remove(600);
  for (int tick = 0; tick < 3; ++tick) server.tick_for(replica);
  EXPECT_EQ(replica.count(), server.model().count());
  EXPECT_FALSE(server.stream.full());

  ToyServer large(18, 1500, Appearance::Transfer, options);
  test::ShownReplica another(1000);
  join(large.stream, another);
  EXPECT_EQ(another.count(), 1000U);
}

TEST(StreamModel, GaussiansThatAreNotFiniteAreLeftOut) {
  ToyServer server(7, 100);
  test::ShownReplica replica;
  join(server.stream, replica);
  server.insert(10);
  server.model().parameters[105] = std::numeric_limits<float>::quiet_NaN();
  const float held = server.model().parameters[3];
  server.model().parameters[3] = std::numeric_limits<float>::infinity();
  server.tick_for(replica);
  EXPECT_EQ(replica.count(), 109U);
  server.model().parameters[105] = 0.25F;
  server.model().parameters[3] = held;
  server.tick_for(replica);
  EXPECT_EQ(replica.count(), 110U);
}

TEST(StreamModel, DuplicateIdsAreStreamedOnce) {
  ToyServer server(8, 50);
  test::ShownReplica replica;
  join(server.stream, replica);
  server.insert(4);
  server.model().gaussian_id[52] = server.model().gaussian_id[51];
  server.model().gaussian_id[53] = server.model().gaussian_id[2];
  for (int tick = 0; tick < 3; ++tick) server.tick_for(replica);
  EXPECT_EQ(replica.count(), 52U);
}

TEST(StreamModel, AnObservationThatWasTornIsThrownAway) {
  ToyServer server(9, 50);
  const GaussiansBuffer other = test::toy_model(80, 4, 1000);
  EXPECT_FALSE(server.stream.observe(other.view(), [] { return false; }));
  server.stream.make_tick(1e9, {});
  EXPECT_TRUE(test::packets_of(server.stream).empty());
  EXPECT_EQ(server.stream.observed_count(), 50U);
}

TEST(StreamModel, AnotherLayoutNeedsAJump) {
  ToyServer server(10, 50);
  const GaussiansBuffer other = test::toy_model(80, 4, 1, Appearance::Radiance, 2);
  EXPECT_TRUE(server.stream.observe(other.view()));
  EXPECT_FALSE(server.stream.ready());
  server.stream.reset_to_target();
  test::ShownReplica replica;
  join(server.stream, replica);
  EXPECT_EQ(replica.count(), 80U);
  EXPECT_EQ(replica.view().layout, other.layout());
}

TEST(StreamModel, AnEmptyModelGrows) {
  StreamModel stream(PacketWriter("streamer", 1), 5);
  const GaussiansBuffer none(ParameterLayout{}, 0);
  ASSERT_TRUE(stream.observe(none.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  join(stream, replica);
  EXPECT_EQ(replica.epoch(), 6U);
  ASSERT_TRUE(stream.observe(test::toy_model(100, 1).view()));
  stream.make_tick(1e9, {});
  test::send_pages(stream, replica);
  EXPECT_EQ(replica.count(), 100U);
  ASSERT_TRUE(stream.observe(none.view()));
  stream.make_tick(1e9, {});
  send(test::packets_of(stream), replica);
  EXPECT_EQ(replica.count(), 0U);
}

TEST(StreamModel, WhatNobodyHoldsFollowsWithoutAByte) {
  ToyServer server(21, 3000);
  test::ShownReplica replica;
  join(server.stream, replica);
  server.stream.set_holders({1});
  server.train(0.05F);
  for (int tick = 0; tick < 3; ++tick) {
    for (const EncodedPacket& packet : server.tick()) {
      if (packet.body != wire::Body::PageDelta) continue;
      const ParsedPacket parsed = parse(packet);
      for (const wire::PageStep* step : *parsed.root().body_as_PageDelta()->steps()) EXPECT_EQ(step->page(), 1U);
    }
  }
  const ReplicatedState& held = server.stream.held();
  const QuantizedGaussians& target = server.stream.observed_gaussians();
  for (const std::uint32_t number : {0U, 2U}) {
    const HeldPage& page = *held.find(number);
    EXPECT_GT(page.version, replica.held().find(number)->version);
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const std::uint64_t id = held.gaussians.gaussian_id[page.row(lane)];
      ASSERT_EQ(held.gaussians.channels[0][page.row(lane)], target.channels[0][id - 1]);
    }
  }
}

}  // namespace
}  // namespace splatbus::stream
