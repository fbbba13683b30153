// A streamer that goes on with the stream that another one has left.
#include <functional>
#include <map>
#include <random>

#include "toy_server.h"

namespace splatbus::stream {
namespace {

constexpr std::uint64_t kNextEpoch = 99;

class HandedOver : public testing::Test {
 protected:
  HandedOver() {
    server_.scene.light.sources = {{.id = 7, .kind = LightKind::Point, .position = {0, 1, 0}, .intensity = {1, 1, 1}}};
    test::send(server_.change_scene(), viewer_);
    test::join(server_.stream, viewer_);
    for (int tick = 0; tick < 3; ++tick) {
      server_.train(0.02F);
      server_.insert(100);
      server_.remove(40);
      server_.tick_for(viewer_);
    }
    handed_ = server_.stream.hand_over();
  }

  void resume() { next_.resume(read_handover(handed_)); }

  /// What the next one makes of the model as it is now; the viewer follows.
  void tick() {
    ASSERT_TRUE(next_.observe(server_.model().view()));
    ASSERT_TRUE(next_.ready());
    next_.make_tick(1e9, {});
    test::send(test::packets_of(next_), viewer_);
  }

  void expect_followed() const {
    EXPECT_TRUE(viewer_.report().lacks.empty());
    std::map<std::uint32_t, std::uint32_t> offered, held;
    for (const OfferedPage& page : *next_.offered()) offered[page.page] = page.version;
    for (const auto& [number, version] : viewer_.held_pages()) held[number] = version;
    EXPECT_EQ(held, offered);
    for (const auto& [number, page] : next_.held().pages) {
      QuantizedGaussians theirs = next_.held().lanes(page);
      std::ranges::fill(theirs.gaussian_id, 0);
      EXPECT_EQ(viewer_.held().lanes(*viewer_.held().find(number)), theirs) << "page " << number;
    }
  }

  test::ToyServer server_{5, 3000};
  Replica viewer_;
  StreamModel next_{PacketWriter("streamer", 2), kNextEpoch};
  Bytes handed_;
};

TEST_F(HandedOver, IsOfferedAsViewersHoldIt) {
  resume();
  EXPECT_TRUE(next_.ready());
  EXPECT_EQ(next_.status().epoch, server_.stream.status().epoch);
  EXPECT_EQ(next_.scene_version(), server_.scene.version);
  EXPECT_EQ(next_.held().visibility_version, server_.stream.held().visibility_version);
  ASSERT_GT(viewer_.count(), 3000U);
  expect_followed();
  // Where they are is known before anything is observed.
  const auto before = server_.stream.offered(), now = next_.offered();
  ASSERT_EQ(now->size(), before->size());
  for (std::size_t k = 0; k < now->size(); ++k) {
    const float step = next_.status().mean_step;
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR((&(*now)[k].bounds.low.x)[axis], (&(*before)[k].bounds.low.x)[axis], 32 * step);
      EXPECT_NEAR((&(*now)[k].bounds.high.x)[axis], (&(*before)[k].bounds.high.x)[axis], 32 * step);
    }
  }
}

TEST_F(HandedOver, GoesOnInStepsFromWhatViewersHold) {
  resume();
  const std::size_t before = viewer_.count();
  for (int time = 0; time < 3; ++time) {
    server_.train(0.02F);
    server_.insert(50);
    server_.remove(20);
    ASSERT_NO_FATAL_FAILURE(tick());
  }
  EXPECT_GT(viewer_.count(), before);
  EXPECT_EQ(viewer_.count(), server_.model().count());
  expect_followed();
}

TEST_F(HandedOver, NothingGoesOutWhereNothingHasChanged) {
  server_.tick_for(viewer_);
  handed_ = server_.stream.hand_over();
  resume();
  // What rounds otherwise may differ by a step; nothing comes or goes.
  ASSERT_TRUE(next_.observe(server_.model().view()));
  next_.make_tick(1e9, {});
  const StreamUpdate update = next_.take_update();
  EXPECT_TRUE(update.gone.empty());
  for (const DeltaPacket& delta : update.deltas) {
    for (const DeltaPacket::Step& step : delta.steps) EXPECT_FALSE(step.other_lanes) << "page " << step.page;
  }
}

TEST_F(HandedOver, GaussiansKeepTheirIds) {
  resume();
  std::size_t known = 0;
  for (const auto& [number, page] : next_.held().pages) {
    for (std::uint32_t lane = 0; lane < page.count; ++lane, ++known) {
      ASSERT_EQ(next_.held().gaussians.gaussian_id[page.row(lane)], server_.id_at(number, lane));
    }
  }
  EXPECT_EQ(known, server_.model().count());
}

TEST_F(HandedOver, ScenesGoOnFromTheOneThatViewersHold) {
  resume();
  server_.scene.light.sun_direction = {0, 0.6F, 0.8F};
  ++server_.scene.version;
  const auto packet = next_.take_scene(server_.scene, {.frame = 9, .capture_ns = 7});
  ASSERT_TRUE(packet);
  viewer_.receive(test::parse(*packet));
  EXPECT_FALSE(viewer_.report().scene_lost);
  EXPECT_EQ(viewer_.scene_version(), server_.scene.version);
  EXPECT_NEAR(viewer_.scene().light.sun_direction.z, 0.8F, 1e-3F);
}

TEST_F(HandedOver, AModelOfAnotherLayoutBeginsAStreamOfItsOwn) {
  resume();
  const GaussiansBuffer other = test::toy_model(200, 1, 1, Appearance::Radiance);
  ASSERT_TRUE(next_.observe(other.view()));
  EXPECT_FALSE(next_.ready());
  next_.reset_to_target();
  EXPECT_GT(next_.status().epoch, kNextEpoch);
  EXPECT_EQ(next_.status().gaussians, 200U);
}

/// A flatbuffer's bytes that are changed in place say something else, or nothing at all.
TEST_F(HandedOver, WhatIsDamagedIsRefused) {
  std::mt19937 random(3);
  int refused = 0;
  for (int mutant = 0; mutant < 400; ++mutant) {
    Bytes bytes = handed_;
    for (int k = 0; k < 1 + mutant % 3; ++k) bytes[random() % bytes.size()] ^= 1U << random() % 8;
    if (mutant % 7 == 0) bytes.resize(random() % bytes.size());
    try {
      const StreamHandover read = read_handover(bytes);
      std::size_t rows = 0;
      for (const auto& [number, page] : read.held.pages) rows += page.count;
      EXPECT_EQ(rows, read.held.count);
    } catch (const StreamError&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 100);
}

/// With the ids of each page as `change` leaves them.
Bytes with_ids(const Bytes& handed, const std::function<void(std::vector<std::uint64_t>&)>& change) {
  flatbuffers::FlatBufferBuilder builder;
  const auto& root = *flatbuffers::GetRoot<wire::StreamHandover>(handed.data());
  const auto copy = [&](const flatbuffers::Vector<std::uint8_t>& bytes) {
    return builder.CreateVector(bytes.data(), bytes.size());
  };
  std::vector<flatbuffers::Offset<wire::HandedPage>> pages;
  for (const wire::HandedPage* page : *root.pages()) {
    std::vector<std::uint64_t> ids(page->gaussian_ids()->begin(), page->gaussian_ids()->end());
    change(ids);
    const auto packet_at = copy(*page->packet()), payload_at = copy(*page->payload());
    pages.push_back(wire::CreateHandedPage(builder, packet_at, payload_at, builder.CreateVector(ids)));
  }
  const auto layout_at = copy(*root.layout()), scene_at = copy(*root.scene());
  builder.Finish(wire::CreateStreamHandover(builder, root.stream_epoch(), root.version(), 0, layout_at, scene_at,
                                            builder.CreateVector(pages)));
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

TEST_F(HandedOver, PagesWithoutTheIdsOfTheirGaussiansAreRefused) {
  EXPECT_NO_THROW((void)read_handover(with_ids(handed_, [](auto&) {})));
  EXPECT_THROW((void)read_handover(with_ids(handed_, [](auto& ids) { ids.pop_back(); })), StreamError);
  EXPECT_THROW((void)read_handover(with_ids(handed_, [](auto& ids) { ids.front() = 0; })), StreamError);
}

TEST_F(HandedOver, OfAnIdThatComesTwiceOneIsHeldAfterATick) {
  handed_ = with_ids(handed_, [](auto& ids) { ids.back() = ids.front(); });
  resume();
  ASSERT_NO_FATAL_FAILURE(tick());
  test::send_pages(next_, viewer_);
  EXPECT_EQ(next_.status().gaussians, server_.model().count());
  EXPECT_EQ(viewer_.count(), server_.model().count());
}

}  // namespace
}  // namespace splatbus::stream
