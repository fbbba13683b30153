#include "stream/replica.h"

#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <random>
#include <set>

#include "expectations.h"
#include "shown_replica.h"
#include "stream/bytes.h"
#include "stream/codecs.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::expect_exact;
using test::expect_shown;
using test::join;
using test::parse;
using test::send;
using test::ToyServer;

TEST(ClosedLoop, MirrorAndReplicaAgreeBitForBitAfterRandomHistories) {
  for (std::uint32_t seed = 1; seed <= 6; ++seed) {
    std::mt19937 random(seed);
    ToyServer server(seed, 1500, seed % 2 ? Appearance::Transfer : Appearance::Radiance);
    test::ShownReplica replica;
    join(server.stream, replica);
    for (int tick = 0; tick < 40; ++tick) {
      switch (random() % 5) {
        case 0:
          server.insert(random() % 400);
          break;
        case 1:
          server.remove(random() % 60);
          break;
        case 2:
          server.scene.light.sun_irradiance.x += 1, ++server.scene.light.generation;
          break;
        case 3:
          server.scene.objects[random() % 3].rigid.translation.y += 0.1F;
          break;
        default:
          break;
      }
      server.train(0.02F);
      server.tick_for(replica, random() % 3 ? 3000 : 1e9);
      ASSERT_FALSE(replica.report().urgent());
      if (tick % 8 == 0) expect_exact(server.stream, replica);
      if (HasFailure()) return;
    }
    expect_exact(server.stream, replica);
    expect_shown(replica);
    EXPECT_EQ(replica.scene().light.sun_irradiance, server.scene.light.sun_irradiance);
    EXPECT_EQ(replica.scene().objects.size(), server.scene.objects.size());
    test::ShownReplica late;
    join(server.stream, late, kBlockRows);
    expect_exact(server.stream, late);
    expect_shown(late);
  }
}

TEST(ClosedLoop, EveryGaussianKeepsItsObject) {
  ToyServer server(4);
  test::ShownReplica replica;
  join(server.stream, replica);
  server.insert(300);
  server.remove(100);
  server.train(0.01F);
  for (int tick = 0; tick < 3; ++tick) server.tick_for(replica);
  std::map<std::uint64_t, std::uint32_t> object_of;
  for (std::size_t i = 0; i < server.model().count(); ++i) {
    object_of[server.model().gaussian_id[i]] = server.model().object_id[i];
  }
  ASSERT_EQ(replica.count(), object_of.size());
  test::for_each_held(server, replica, [&](std::uint64_t id, std::uint32_t row) {
    ASSERT_TRUE(object_of.contains(id));
    EXPECT_EQ(object_of[id], replica.held().gaussians.object_id[row]);
    object_of.erase(id);
  });
  EXPECT_TRUE(object_of.empty());
}

TEST(Replica, RowsStayWhereTheyAreUntilTheirPageChanges) {
  ToyServer server(5, 3000);
  Replica replica;
  join(server.stream, replica);
  const auto pages = replica.held().pages;
  server.train(0.02F);
  server.tick_for(replica);
  for (const auto& [number, page] : replica.held().pages) {
    EXPECT_GT(page.version, pages.at(number).version);
    EXPECT_EQ(page.blocks, pages.at(number).blocks) << "page " << number;
    EXPECT_EQ(page.structure, pages.at(number).structure);
  }
}

TEST(Replica, OfADeltaThatIsLostOnlyItsPagesStayBehindAndComeWhole) {
  ToyServer server(6, 5000);
  test::ShownReplica replica;
  join(server.stream, replica);
  server.train(0.02F);
  auto lost = server.tick();
  ASSERT_GE(lost.size(), 3U);
  const std::size_t missing = parse(lost[0]).root().body_as_PageDelta()->steps()->size();
  lost.erase(lost.begin());  // the first delta does not come
  send(lost, replica);
  server.train(0.02F);
  send(server.tick(), replica);
  const auto lacks = replica.report().lacks;
  ASSERT_EQ(lacks.size(), missing);
  std::size_t whole = 0;
  for (const auto& [page, version] : lacks) {
    EXPECT_EQ(replica.held().find(page)->version, version);
    EXPECT_LT(version, server.stream.held().find(page)->version);
    for (const PagePacket& part : server.stream.page_packets(page)) replica.receive(parse(part.packet)), ++whole;
  }
  EXPECT_EQ(whole, missing);
  expect_exact(server.stream, replica);
  expect_shown(replica);
}

TEST(Replica, GapsInTheNumbersAreReportedOnceAndAnotherConnectionCountsAnew) {
  ToyServer server(7, 100);
  Replica replica;
  const PacketWriter writer("streamer", 1);
  const auto welcome = [&](std::uint64_t connection) {
    replica.receive(parse(writer.write(77, 0, wire::Body::Welcome, [&](auto& b) {
      return wire::CreateWelcome(b, wire::Appearance::Transfer, 0, 77, 5, false, connection);
    })));
  };
  const auto keepalive = [&](std::uint64_t sequence) {
    replica.receive(parse(writer.write(77, sequence, wire::Body::Keepalive,
                                       [](auto& b) { return wire::CreateKeepalive(b, 1, 1, 1, 1); })));
  };
  welcome(1);
  for (const std::uint64_t sequence : {1U, 2U, 5U, 6U, 9U}) keepalive(sequence);
  EXPECT_EQ(replica.report().newest, 9U);
  EXPECT_EQ(replica.report().missing, (std::vector<SequenceRange>{{3, 4}, {7, 8}}));
  replica.clear_report();
  keepalive(10);
  EXPECT_TRUE(replica.report().missing.empty());
  welcome(1);  // once more
  EXPECT_EQ(replica.report().newest, 10U);
  welcome(2);
  keepalive(1);
  EXPECT_EQ(replica.report().newest, 1U);
  EXPECT_TRUE(replica.report().missing.empty());
}

TEST(Replica, TheNewestNumberStaysSoWhenAnOlderOneComesLate) {
  Replica replica;
  const PacketWriter writer("streamer", 1);
  const auto keepalive = [&](std::uint64_t sequence) {
    replica.receive(parse(writer.write(77, sequence, wire::Body::Keepalive,
                                       [](auto& b) { return wire::CreateKeepalive(b, 1, 1, 1, 1); })));
  };
  for (const std::uint64_t sequence : {1U, 2U, 5U, 3U, 1U}) keepalive(sequence);
  EXPECT_EQ(replica.report().newest, 5U);
  keepalive(6);
  EXPECT_EQ(replica.report().newest, 6U);
  EXPECT_EQ(replica.report().missing, (std::vector<SequenceRange>{{3, 4}}));
}

TEST(Replica, AnOlderStateOfAPageThatComesLateChangesNothing) {
  ToyServer server(14, 1500);
  test::ShownReplica replica;
  join(server.stream, replica);
  const auto late = server.stream.page_packets(1);
  server.train(0.05F);
  server.tick_for(replica);
  ASSERT_GT(replica.held().find(1)->version, late[0].version);
  for (const PagePacket& part : late) replica.receive(parse(part.packet));
  EXPECT_TRUE(replica.report().lacks.empty());
  expect_exact(server.stream, replica);
  expect_shown(replica);
}

TEST(Replica, PartsMakeAPageInAnyOrderAndAreShownAsTheyCome) {
  ToyServer server(8, 900);
  auto parts = server.stream.page_packets(0, kBlockRows);
  ASSERT_EQ(parts.size(), 4U);
  std::ranges::reverse(parts);
  test::ShownReplica replica;
  replica.receive(parse(server.stream.layout_packet()));
  std::size_t shown = 0;
  for (const PagePacket& part : parts) {
    EXPECT_FALSE(replica.held().find(0) && replica.held().find(0)->whole());
    replica.receive(parse(part.packet));
    shown += parse(part.packet).root().body_as_Page()->part();
    EXPECT_EQ(test::count_shown(replica.view()), shown);
    EXPECT_LE(replica.view().ranges.size(), 2U)
        << "a page's blocks make one range, or the rasteriser would have room for none";
  }
  EXPECT_EQ(shown, 900U);
  expect_shown(replica);
  EXPECT_TRUE(replica.held().find(0)->whole());
}

TEST(Replica, WhatIsMoreThanItTakesIsDeclinedAndTheRestStays) {
  ToyServer server(9, 3000);
  test::ShownReplica replica(2100);
  join(server.stream, replica);
  EXPECT_EQ(replica.count(), 2048U);
  EXPECT_EQ(replica.report().dropped, std::vector<std::uint32_t>{2});
  replica.receive(parse(server.stream.gone_packet(std::vector<std::uint32_t>{0})));
  EXPECT_EQ(replica.count(), 1024U);
  for (const PagePacket& part : server.stream.page_packets(2)) replica.receive(parse(part.packet));
  EXPECT_EQ(replica.count(), 3000U - 1024);
  expect_shown(replica);
}

TEST(Replica, ThePictureOfTheEpochBeforeStaysUntilAsMuchOfTheNewOneHasCome) {
  ToyServer server(10, 3000), next(11, 3000, Appearance::Transfer, {}, 90);
  test::ShownReplica replica;
  join(server.stream, replica);
  const float before = *replica.view().at(0, 0);
  replica.receive(parse(next.stream.layout_packet()));
  send(next.stream.manifest_packets(*next.stream.offered(), {}, true), replica);
  EXPECT_EQ(replica.epoch(), 91U);
  for (std::uint32_t page = 0; page < 2; ++page) {
    replica.receive(parse(next.stream.page_packets(page)[0].packet));
    EXPECT_EQ(replica.count(), 3000U);
    EXPECT_EQ(*replica.view().at(0, 0), before);
  }
  replica.receive(parse(next.stream.page_packets(2)[0].packet));
  EXPECT_EQ(replica.count(), 3000U);
  expect_exact(next.stream, replica);
  expect_shown(replica);
  // What is late of the old one is nobody's.
  server.train(0.1F);
  send(server.tick(), replica);
  expect_exact(next.stream, replica);
}

TEST(Replica, ChangesThatNobodyTakesDoNotGrowWithoutBound) {
  ToyServer server(12, 2000);
  Replica replica;
  join(server.stream, replica);
  const std::size_t whole = replica.whole().bytes();
  for (int tick = 0; tick < 60; ++tick) {
    server.train(0.05F);
    server.tick_for(replica);
  }
  DisplayChanges changes = replica.take_changes();
  EXPECT_LE(changes.bytes(), (std::size_t{1} << 20) + 4 * whole);
  DisplayGaussians late, fresh;
  late.apply(changes);
  fresh.apply(replica.whole());
  ASSERT_EQ(late.count(), fresh.count());
  EXPECT_EQ(*late.view().at(3, 700), *fresh.view().at(3, 700));
}

TEST(Lanes, ThoseAtTheEndFillTheGapsInOrder) {
  const auto after = [](std::uint32_t count, std::vector<std::uint32_t> gone) { return lanes_after(count, gone); };
  EXPECT_EQ(after(6, {1, 3}), (std::vector<std::uint32_t>{0, 4, 2, 5}));
  EXPECT_EQ(after(6, {1, 5}), (std::vector<std::uint32_t>{0, 4, 2, 3}));
  EXPECT_EQ(after(6, {4, 5}), (std::vector<std::uint32_t>{0, 1, 2, 3}));
  EXPECT_EQ(after(5, {0, 1, 2, 4}), (std::vector<std::uint32_t>{3}));
  EXPECT_EQ(after(3, {0, 1, 2}), (std::vector<std::uint32_t>{}));
}

TEST(Replica, PagesThatEndBeforeTheyCameAreNotMissedAnyLonger) {
  test::ToyServer server(3, 3000);
  Replica replica;
  replica.receive(test::parse(server.stream.layout_packet()));
  test::send(server.stream.manifest_packets(*server.stream.offered(), {}, true), replica);
  EXPECT_EQ(replica.missing_pages(), 3U);
  const std::vector<std::uint32_t> gone{1};
  test::send(server.stream.manifest_packets({}, gone, false), replica);
  EXPECT_EQ(replica.missing_pages(), 2U);
}

}  // namespace
}  // namespace splatbus::stream
