// What a replica believes of another: what read_share() lets through.
#include "streamer/share_message.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "../../stream/toy_server.h"

namespace splatbus::streamer {
namespace {

/// All that a streamer with a model has to say.
class ShareMessages : public testing::Test {
 protected:
  ShareMessages() {
    server_.train(0.02F);
    EXPECT_TRUE(server_.stream.observe(server_.model().view()));
    server_.stream.make_tick(1e9, {});
    const auto status = server_.stream.status();
    said_.deltas = server_.stream.take_update().deltas;
    said_.pages = *server_.stream.offered();
    said_.viewers = {.followed = true, .bytes_per_s = 1000, .held = {3, 9}, .cameras = {camera()}};
    for (const auto part : {wire::SharePart::Whole, wire::SharePart::Parts}) {
      ShareAnswer answer{.what = {1, part}, .packets = {}};
      for (auto& packet :
           server_.stream.page_packets(1, part == wire::SharePart::Parts ? stream::kBlockRows : kPageLanes)) {
        answer.version = packet.version;
        answer.structure = packet.structure;
        answer.packets.push_back(std::move(packet.packet));
      }
      said_.answers.push_back(std::move(answer));
    }
    ShareAnswer seen{.what = {2, wire::SharePart::Visibility}, .packets = server_.stream.page_visibility(2)};
    seen.structure = said_.pages->at(2).structure;
    said_.answers.push_back(std::move(seen));
    said_.wants = {{7, wire::SharePart::Whole}, {8, wire::SharePart::Visibility}};
    said_.place = {.epoch = status.epoch,
                   .layout = status.layout,
                   .mean_step = status.mean_step,
                   .version = status.version,
                   .encodes = true};
  }
  static Camera camera() { return look_at({0, 1, 2}, {0, 0, 0}, 64, 48, 1); }
  /// `spoil` changes what is on its way.
  static ShareMessage passed(const ShareMessage& said, const std::function<void(wire::StreamShare&)>& spoil = {}) {
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "StreamShare/1", "streamer-2");
    builder.Finish(write_share(builder, header, said));
    flatbuffers::Verifier verifier(builder.GetBufferPointer(), builder.GetSize());
    EXPECT_TRUE(verifier.VerifyBuffer<wire::StreamShare>(nullptr));
    auto& body = *flatbuffers::GetMutableRoot<wire::StreamShare>(builder.GetBufferPointer());
    if (spoil) spoil(body);
    return read_share(body);
  }
  void refused(const char* why, const std::function<void(ShareMessage&)>& spoil) {
    ShareMessage said = said_;
    spoil(said);
    EXPECT_THROW(passed(said), std::runtime_error) << why;
  }
  static std::size_t first_delta_of(const ShareMessage& message) {
    for (std::size_t k = 0; k < message.deltas.size(); ++k) {
      if (!message.deltas[k].steps.empty()) return k;
    }
    ADD_FAILURE() << "no steps";
    return 0;
  }

  stream::test::ToyServer server_{9, 5'000};
  ShareMessage said_;
};

// Whose a page is, is remembered by its number: no message makes that grow.
TEST_F(ShareMessages, NoPageHasANumberBeyondTheLast) {
  static constexpr auto kBeyond = static_cast<std::uint32_t>(stream::kMaxPageNumber);
  refused("held", [](ShareMessage& said) { said.viewers->held.insert(kBeyond); });
  refused("wanted", [](ShareMessage& said) { said.wants[0].page = kBeyond; });
  refused("offered", [](ShareMessage& said) { said.pages->back().page = kBeyond; });
  ShareMessage& all = said_;
  const auto spoil = [&](const std::function<void(wire::Packet&)>& change) {
    ShareMessage said = all;
    stream::DeltaPacket& delta = said.deltas[first_delta_of(said)];
    change(*flatbuffers::GetMutableRoot<wire::Packet>(delta.packet.packet.data()));
    EXPECT_THROW(passed(said), stream::StreamError);
  };
  const auto first_step = [](wire::Packet& packet) -> wire::PageStep& {
    auto* body = static_cast<wire::PageDelta*>(packet.mutable_body());
    return *body->mutable_steps()->GetMutableObject(0);
  };
  spoil([&](wire::Packet& packet) { first_step(packet).mutate_page(kBeyond); });
  spoil([&](wire::Packet& packet) { first_step(packet).mutate_base(kBeyond); });
}

TEST_F(ShareMessages, WhatIsSaidIsWhatIsRead) {
  ASSERT_GE(said_.pages->size(), 4U);
  ASSERT_FALSE(said_.deltas.empty());
  ASSERT_GT(said_.answers[1].packets.size(), 1U);
  const ShareMessage read = passed(said_);
  EXPECT_EQ(read.place.epoch, said_.place.epoch);
  EXPECT_EQ(read.place.layout, said_.place.layout);
  EXPECT_EQ(read.place.mean_step, said_.place.mean_step);
  EXPECT_EQ(read.place.version, said_.place.version);
  EXPECT_TRUE(read.place.encodes);
  ASSERT_TRUE(read.viewers);
  EXPECT_EQ(read.viewers->held, said_.viewers->held);
  ASSERT_EQ(read.viewers->cameras.size(), 1U);
  EXPECT_EQ(read.viewers->cameras[0].width, 64U);
  EXPECT_EQ(read.wants, said_.wants);
  ASSERT_EQ(read.pages->size(), said_.pages->size());
  for (std::size_t k = 0; k < read.pages->size(); ++k) {
    const stream::OfferedPage &a = (*read.pages)[k], &b = (*said_.pages)[k];
    EXPECT_EQ(std::tuple(a.page, a.version, a.structure, a.count, a.object_id, a.level, a.frozen),
              std::tuple(b.page, b.version, b.structure, b.count, b.object_id, b.level, b.frozen));
    EXPECT_EQ(a.bounds.low.x, b.bounds.low.x);
    EXPECT_EQ(a.bounds.high.z, b.bounds.high.z);
    EXPECT_EQ(a.bounds.max_scale_m, b.bounds.max_scale_m);
  }
  ASSERT_EQ(read.deltas.size(), said_.deltas.size());
  for (std::size_t k = 0; k < read.deltas.size(); ++k) {
    const stream::DeltaPacket &a = read.deltas[k], &b = said_.deltas[k];
    EXPECT_EQ(a.packet.packet, b.packet.packet);
    EXPECT_EQ(a.packet.payload, b.packet.payload);
    EXPECT_EQ(a.gone, b.gone);
    ASSERT_EQ(a.steps.size(), b.steps.size());
    for (std::size_t i = 0; i < a.steps.size(); ++i) {
      const auto figures = [](const stream::DeltaPacket::Step& step) {
        return std::tuple(step.page, step.base, step.from_version, step.version, step.count, step.other_lanes,
                          step.steps);
      };
      EXPECT_EQ(figures(a.steps[i]), figures(b.steps[i]));
    }
  }
  ASSERT_EQ(read.answers.size(), said_.answers.size());
  for (std::size_t k = 0; k < read.answers.size(); ++k) {
    EXPECT_EQ(read.answers[k].what, said_.answers[k].what);
    EXPECT_EQ(read.answers[k].version, said_.answers[k].version);
    EXPECT_EQ(read.answers[k].structure, said_.answers[k].structure);
    ASSERT_EQ(read.answers[k].packets.size(), said_.answers[k].packets.size());
    for (std::size_t i = 0; i < read.answers[k].packets.size(); ++i) {
      EXPECT_EQ(read.answers[k].packets[i].payload, said_.answers[k].packets[i].payload);
    }
  }
}

TEST_F(ShareMessages, WhatTouchesNothingButWantsIsRead) {
  ShareMessage said;
  said.wants = {{7, wire::SharePart::Parts}};
  const ShareMessage read = passed(said);
  EXPECT_EQ(read.wants, said.wants);
  EXPECT_FALSE(read.viewers);
  EXPECT_FALSE(read.pages);
  EXPECT_FALSE(read.place.encodes);
}

TEST_F(ShareMessages, PacketsOfAnotherStreamOrKindAreRefused) {
  refused("another epoch", [](auto& said) { ++said.place.epoch; });
  refused("a layout", [&](auto& said) { said.answers[0].packets = {server_.stream.layout_packet()}; });
  refused("no packet", [](auto& said) { said.answers[0].packets[0].packet.resize(20); });
  refused("no version of the scene", [](auto& said) {
    const auto pages = std::vector<wire::SeenPage>{};
    auto packet =
        stream::PacketWriter("streamer", 1).write(said.place.epoch, 0, wire::Body::LightVisibility, [&](auto& builder) {
          return wire::CreateLightVisibilityDirect(builder, 0, 0, &pages);
        });
    said.visibility.push_back({std::move(packet), {}});
  });
  refused("no number", [](auto& said) {
    // As PacketWriter writes, but for the place of the number.
    flatbuffers::FlatBufferBuilder builder;
    const auto header = wire::CreateHeaderDirect(builder, "Packet/4", "");
    const auto pages = std::vector<wire::SeenPage>{};
    const auto body = wire::CreateLightVisibilityDirect(builder, 1, 0, &pages);
    builder.Finish(wire::CreatePacket(builder, header, said.place.epoch, wire::Body::LightVisibility, body.Union()));
    said.visibility.push_back({{.body = wire::Body::LightVisibility,
                                .sequence = 0,
                                .packet = {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()},
                                .payload = {}},
                               {}});
  });
}

TEST_F(ShareMessages, PartsOfPagesThatDoNotMakeOneAreRefused) {
  refused("the last is missing", [](auto& said) { said.answers[1].packets.pop_back(); });
  refused("one in between is missing",
          [](auto& said) { said.answers[1].packets.erase(said.answers[1].packets.begin() + 1); });
  refused("the first is missing", [](auto& said) {
    said.answers.erase(said.answers.begin());
    said.answers[0].packets.erase(said.answers[0].packets.begin());
  });
  refused("newer than all", [](auto& said) {
    said.pages.reset();
    said.deltas.clear();
    said.place.version = said.answers[0].version - 1;
  });
}

TEST_F(ShareMessages, FiguresOfStepsHaveToBeThoseOfTheSteps) {
  refused("one too few", [](auto& said) { said.deltas[first_delta_of(said)].steps.pop_back(); });
  refused("no number", [](auto& said) {
    said.deltas[first_delta_of(said)].steps[0].steps = std::numeric_limits<float>::quiet_NaN();
  });
  refused("less than nothing", [](auto& said) { said.deltas[first_delta_of(said)].steps[0].steps = -1; });
  refused("newer than all", [](auto& said) {
    said.pages.reset();
    said.answers.clear();
    said.place.version = said.deltas[first_delta_of(said)].steps[0].version - 1;
  });
}

TEST_F(ShareMessages, PagesThatNoStreamerHasAreRefused) {
  refused("not ascending", [](auto& said) { std::swap(said.pages->at(0), said.pages->at(1)); });
  refused("twice", [](auto& said) { said.pages->at(1) = said.pages->at(0); });
  refused("without Gaussians", [](auto& said) { said.pages->at(0).count = 0; });
  refused("too many Gaussians", [](auto& said) { said.pages->at(0).count = kPageLanes + 1; });
  refused("newer than all", [](auto& said) { said.pages->at(0).version = said.place.version + 1; });
  refused("a number that no page has",
          [](auto& said) { said.pages->back().page = static_cast<std::uint32_t>(stream::kMaxPageNumber); });
}

TEST_F(ShareMessages, BoundsThatAreNoneAreNone) {
  ShareMessage said = said_;
  said.pages->at(1).bounds.low.y = std::numeric_limits<float>::quiet_NaN();
  said.pages->at(2).bounds.max_scale_m = std::numeric_limits<float>::infinity();
  const ShareMessage read = passed(said);
  EXPECT_TRUE(read.pages->at(0).bounds.low.x <= read.pages->at(0).bounds.high.x);
  EXPECT_FALSE(read.pages->at(1).bounds.low.x <= read.pages->at(1).bounds.high.x);
  EXPECT_FALSE(read.pages->at(2).bounds.low.x <= read.pages->at(2).bounds.high.x);
}

TEST_F(ShareMessages, WhatIsBeyondAllBoundsIsRefused) {
  refused("a rate", [](auto& said) { said.viewers->bytes_per_s = std::numeric_limits<double>::infinity(); });
  refused("a camera", [](auto& said) { said.viewers->cameras[0].fx = 0; });
  refused("cameras", [](auto& said) { said.viewers->cameras.resize(17, camera()); });
  refused("wants", [](auto& said) { said.wants.resize(kMaxShareWants + 1); });
  refused("a version", [](auto& said) { said.place.version = kVersionBlocks * kVersionBlock; });
  refused("a step of means", [](auto& said) { said.place.mean_step = 0; });
  refused("a step of means", [](auto& said) { said.place.mean_step *= 1.5F; });
  refused("a step of means", [](auto& said) { said.place.mean_step = 0x1p-21F; });
  refused("a step of means", [](auto& said) { said.place.mean_step = std::numeric_limits<float>::quiet_NaN(); });
  said_.place.layout.appearance = Appearance::Radiance;  // a default is not written, and cannot be changed
  EXPECT_THROW(passed(said_, [](wire::StreamShare& body) { body.mutate_appearance(static_cast<wire::Appearance>(9)); }),
               std::runtime_error);
}

}  // namespace
}  // namespace splatbus::streamer
