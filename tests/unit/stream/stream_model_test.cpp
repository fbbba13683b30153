#include "stream/stream_model.h"

#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <set>

#include "../gaussians/paged_model.h"
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

TEST(StreamModel, AStepSaysHowManyGaussiansThePageHasThen) {
  ToyServer server(22, 3000);
  server.remove(40);
  server.insert(100);
  server.train(0.05F);
  ASSERT_TRUE(server.stream.observe(server.model().view()));
  server.stream.make_tick(1e9, {});
  std::size_t structures = 0;
  for (const DeltaPacket& delta : server.stream.take_update().deltas) {
    for (const DeltaPacket::Step& step : delta.steps) {
      structures += step.other_lanes ? 1 : 0;
      EXPECT_EQ(step.count, server.stream.held().find(step.page)->count);
    }
  }
  EXPECT_GE(structures, 2U);
}

TEST(StreamModel, APageWhoseGaussiansAreAllOthersAndNotFiniteEnds) {
  ToyServer server(23, 1500);
  test::ShownReplica replica;
  join(server.stream, replica);
  for (std::size_t i = kPageLanes; i < server.model().count(); ++i) {
    server.model().gaussian_id[i] += 10'000;
    server.model().parameters[i] = std::numeric_limits<float>::quiet_NaN();
  }
  ASSERT_TRUE(server.stream.observe(server.model().view()));
  server.stream.make_tick(1e9, {});
  send(test::packets_of(server.stream), replica);
  EXPECT_EQ(replica.count(), std::size_t{kPageLanes});
  test::expect_exact(server.stream, replica);
}

// As the trainer splits one: its number is free then, and what was in it is in two new ones.
TEST(StreamModel, APageThatIsSplitTravelsAsItsLanes) {
  const GaussiansBuffer model = test::toy_model(1000, 3);
  splatbus::test::PagedModel paged(model.view(), 1024, 100);
  ASSERT_EQ(paged.ranges.size(), 2U) << "the world, and object 7";
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  join(stream, replica);
  const std::size_t whole = stream.page_packets(0)[0].packet.bytes();

  const std::uint32_t count = paged.ranges[0].count, low = count / 2;
  // Pages 2 and 3 have what page 0 had.
  const std::vector<float> before(paged.memory);
  paged.memory.resize(4 * paged.page_floats);
  const std::size_t rows = paged.page_floats / kPageLanes;
  for (std::size_t row = 0; row < rows; ++row) {
    const bool wide = row + 2 >= rows;  // ids: two rows of one array
    if (wide) continue;
    for (std::uint32_t lane = 0; lane < count; ++lane) {
      const std::size_t page = lane < low ? 2 : 3, to = lane < low ? lane : lane - low;
      paged.memory[page * paged.page_floats + row * kPageLanes + to] = before[row * kPageLanes + lane];
    }
  }
  const auto ids = [&](float* memory, std::size_t page) {
    return reinterpret_cast<std::uint64_t*>(memory + page * paged.page_floats + (rows - 2) * kPageLanes);
  };
  for (std::uint32_t lane = 0; lane < count; ++lane) {
    const std::size_t page = lane < low ? 2 : 3, to = lane < low ? lane : lane - low;
    ids(paged.memory.data(), page)[to] = ids(const_cast<float*>(before.data()), 0)[lane];
  }
  paged.ranges = {paged.ranges[1], {2 * kPageLanes, low, 0}, {3 * kPageLanes, count - low, 0}};
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.make_tick(1e9, {});
  const auto packets = test::packets_of(stream);
  ASSERT_EQ(packets.size(), 1U);
  EXPECT_LT(packets[0].bytes(), 2000U);
  EXPECT_GT(whole, 10'000U);
  send(packets, replica);
  EXPECT_EQ(replica.held().pages.size(), 3U);
  EXPECT_FALSE(replica.held().find(0));
  EXPECT_EQ(replica.count(), 1000U);
  test::expect_exact(stream, replica);
  test::expect_shown(replica);
}

// Of a page in a place that is seen for the first time: more comes than a packet of its lanes may bring.
TEST(StreamModel, APageThatBecomesManyReachesViewersWhole) {
  constexpr std::size_t kFill = 960, kPages = 6, kKept = kFill / kPages;
  GaussiansBuffer one = test::toy_model(kFill, 3), many = test::toy_model(kFill * kPages, 4);
  std::ranges::fill(one.object_id, 0U);
  std::ranges::fill(many.object_id, 0U);
  for (std::size_t i = 0; i < many.count(); ++i) {
    const std::size_t page = i / kFill, lane = i % kFill;
    many.gaussian_id[i] = lane < kKept ? page * kKept + lane + 1 : 10'000 + i;
  }
  const splatbus::test::PagedModel before(one.view(), kFill, 100), after(many.view(), kFill, 100);
  ASSERT_EQ(before.ranges.size(), 1U);
  ASSERT_EQ(after.ranges.size(), kPages);
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(before.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  join(stream, replica);
  for (int tick = 0; tick < 2; ++tick) {
    ASSERT_TRUE(stream.observe(after.view()));
    stream.make_tick(1e9, {});
    send(test::packets_of(stream), replica);
    test::send_pages(stream, replica);
  }
  EXPECT_EQ(replica.count(), kFill * kPages);
  test::expect_exact(stream, replica);
  test::expect_shown(replica);
}

TEST(StreamModel, AFrozenPagesBlobStaysAsItIsWhileOthersAndTheLightChange) {
  GaussiansBuffer model = test::toy_model(2000, 3);
  splatbus::test::PagedModel paged(model.view(), 600, 100);
  paged.ranges[0].frozen = 1;
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.reset_to_target();
  const auto blob = [&] {
    const auto packet = parse(stream.page_packets(0)[0].packet);
    const auto payload = packet.payload().first(packet.root().body_as_Page()->blob_bytes());
    return std::pair(packet.root().body_as_Page()->version(), Bytes(payload.begin(), payload.end()));
  };
  const auto first = blob();
  for (int tick = 0; tick < 40; ++tick) {
    for (std::size_t k = paged.page_floats; k < paged.page_floats + 600; ++k) paged.memory[k] += 0.01F;
    ASSERT_TRUE(stream.observe(paged.view()));
    stream.make_tick(1e9, {});
    const std::vector<std::uint32_t> sun{0};
    const std::vector<std::uint8_t> seen(paged.view().count, tick % 2 ? 0 : 255);
    (void)stream.take_visibility({.light_ids = sun, .of_index = seen, .scene_version = 1U + tick});
  }
  EXPECT_EQ(blob(), first);
  EXPECT_TRUE(stream.offered()->at(0).frozen);
  EXPECT_FALSE(stream.offered()->at(1).frozen);
  EXPECT_GT(stream.offered()->at(1).version, 40U);
}

TEST(StreamModel, AFrozenPageIsOfferedAsSuchOnceNothingOfItIsLeftToSend) {
  GaussiansBuffer model = test::toy_model(500, 3);
  splatbus::test::PagedModel paged(model.view(), 600, 100);
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(paged.view()));
  stream.reset_to_target();
  stream.make_tick(1e9, {});
  for (std::size_t k = 0; k < 500; ++k) paged.memory[k] += 0.5F;
  paged.ranges[0].frozen = 1;
  for (int tick = 0; tick < 40; ++tick) {
    ASSERT_TRUE(stream.observe(paged.view()));
    stream.make_tick(0, {});
    ASSERT_FALSE(stream.offered()->at(0).frozen) << "and would be kept for good as it was";
  }
  for (int tick = 0; tick < 40; ++tick) stream.make_tick(1e9, {});
  EXPECT_TRUE(stream.offered()->at(0).frozen);
  const auto& target = stream.observed_gaussians().channels[0];
  const HeldPage& page = *stream.held().find(0);
  for (std::uint32_t lane = 0; lane < page.count; ++lane) {
    const auto id = static_cast<std::size_t>(stream.held().gaussians.gaussian_id[page.row(lane)]);
    EXPECT_NEAR(stream.held().gaussians.channels[0][page.row(lane)], target[id - 1], 1);
  }
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
