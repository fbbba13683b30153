// The sun's visibility on its way to viewers.
#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <unordered_map>

#include "expectations.h"
#include "shown_replica.h"
#include "stream/codecs.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

using test::join;
using test::parse;
using test::send;
using test::ToyServer;

/// Posts 1 m high and 0.3 m wide, a metre apart, throw shadows on a floor with a penumbra of a degree. The sun stands
/// 40 degrees high and turns by 15 degrees a second.
std::vector<std::uint8_t> shadows(const GaussiansBuffer& model, double time_s) {
  const double azimuth = 15 * time_s * std::acos(-1.0) / 180;
  const double cx = std::cos(azimuth), cz = std::sin(azimuth);
  std::vector<std::uint8_t> seen(model.count(), 255);
  for (std::size_t i = 0; i < model.count(); ++i) {
    const double x = model.parameters[i], z = model.parameters[2 * model.stride() + i];
    double visible = 1;
    for (int px = -3; px <= 3; ++px) {
      for (int pz = -3; pz <= 3; ++pz) {
        const double along = (px - x) * cx + (pz - z) * cz, across = std::abs((px - x) * cz - (pz - z) * cx);
        if (along < 0 || along > 1.19) continue;
        visible = std::min(visible, std::clamp((across - 0.15) / (0.017 * along + 1e-6) + 0.5, 0.0, 1.0));
      }
    }
    seen[i] = static_cast<std::uint8_t>(std::lround(255 * visible));
  }
  return seen;
}

void expect_seen(const StreamModel& stream, test::ShownReplica& replica, const GaussiansBuffer& model,
                 const std::vector<std::uint8_t>& truth) {
  std::unordered_map<std::uint64_t, std::size_t> index;
  for (std::size_t i = 0; i < model.count(); ++i) index[model.gaussian_id[i]] = i;
  ASSERT_EQ(replica.count(), model.count());
  const GaussiansView view = replica.view();
  for (const auto& [number, page] : replica.held().pages) {
    const HeldPage& held = *stream.held().find(number);
    for (std::uint32_t lane = 0; lane < page.count; ++lane) {
      const int want = truth[index.at(stream.held().gaussians.gaussian_id[held.row(lane)])];
      const double got = 255.0 * view.visibility[page.row(lane)];
      ASSERT_NEAR(got, want, want == 0 || want == 255 ? 1e-3 : StreamModel::kMaxVisibilityError + 1e-3) << lane;
    }
  }
}

TEST(Visibility, OfATurningSunIsTheSameAtAViewerAtEachVersion) {
  ToyServer server(31, 2000);
  test::ShownReplica replica;
  join(server.stream, replica);
  std::size_t moved = 0;
  for (std::uint64_t version = 10; version < 60; ++version) {
    const auto truth = shadows(server.model(), 0.1 * static_cast<double>(version));
    const auto packets = server.take_visibility(truth, version);
    ASSERT_EQ(packets.size(), 1U);
    send(packets, replica);
    EXPECT_EQ(replica.visibility_version(), version);
    expect_seen(server.stream, replica, server.model(), truth);
    moved += packets[0].packet.payload.size() > 100;
    if (version % 10 == 5) {
      test::ShownReplica late;
      join(server.stream, late);
      expect_seen(server.stream, late, server.model(), truth);
    }
    EXPECT_TRUE(server.take_visibility(truth, version).empty()) << "the same again";
    EXPECT_TRUE(server.take_visibility(truth, version - 1).empty()) << "an older one";
    if (HasFailure()) return;
  }
  EXPECT_GT(moved, 40U) << "the sun does not turn";
}

TEST(Visibility, UntilTheFirstOneComesAPageHasTheModelsOwn) {
  const GaussiansBuffer model = test::toy_model(500, 1);
  StreamModel stream(PacketWriter("streamer", 1), 5);
  ASSERT_TRUE(stream.observe(model.view()));
  stream.reset_to_target();
  test::ShownReplica replica;
  join(stream, replica);
  EXPECT_EQ(replica.visibility_version(), 0U);
  std::vector<std::uint8_t> own;
  for (const float v : model.visibility) own.push_back(static_cast<std::uint8_t>(255 * v));
  expect_seen(stream, replica, model, own);
}

TEST(Visibility, FollowsGaussiansThatComeAndGo) {
  ToyServer server(32, 800);
  test::ShownReplica replica;
  join(server.stream, replica);
  for (int round = 0; round < 10; ++round) {
    server.insert(50);
    server.remove(40);
    ++server.scene.version;
    const auto truth = shadows(server.model(), round);
    for (std::size_t i = 0; i < truth.size(); ++i) server.model().visibility[i] = static_cast<float>(truth[i]) / 255;
    server.tick_for(replica);
    expect_seen(server.stream, replica, server.model(), truth);
    if (HasFailure()) return;
  }
}

class VisibilityRate : public testing::TestWithParam<int> {};

TEST_P(VisibilityRate, Of90000GaussiansStaysWithin1100KbitASecond) {
  const int hz = GetParam();
  ToyServer server(33, 90'000);
  std::size_t bytes = 0, first = 0;
  constexpr int kSeconds = 4;
  for (int frame = 0; frame <= hz * kSeconds; ++frame) {
    const auto packets =
        server.take_visibility(shadows(server.model(), 1.0 / hz * frame), static_cast<std::uint64_t>(frame) + 10);
    for (const VisibilityPacket& packet : packets) (frame == 0 ? first : bytes) += packet.packet.bytes() + 9;
  }
  const double kbps = static_cast<double>(bytes) * 8e-3 / kSeconds;
  RecordProperty("kbps", std::to_string(kbps));
  RecordProperty("first_bytes", std::to_string(first));
  EXPECT_LE(kbps, 1100);
  EXPECT_GT(kbps, 50) << "the sun does not turn";
}

INSTANTIATE_TEST_SUITE_P(Hz, VisibilityRate, testing::Values(10, 20));

TEST(Visibility, IsRefusedByName) {
  ToyServer server(34, 100);
  test::ShownReplica replica;
  join(server.stream, replica);
  const auto truth = shadows(server.model(), 0);
  EXPECT_THROW((void)server.take_visibility(std::span(truth).first(99), 7), StreamError);
  send(server.take_visibility(truth, 7), replica);
  const PacketWriter writer("streamer", 1);
  const auto refusal = [&](std::uint64_t version, const SlotValues& change, std::uint32_t count) -> std::string {
    Payload payload = encode_slot_values(change);
    ReplicatedState held = replica.held();
    const std::vector<wire::SeenPage> pages{{0, held.find(0)->structure, 100}};
    const auto packet = writer.write(
        77, 0, wire::Body::LightVisibility,
        [&](auto& b) {
          return wire::CreateLightVisibility(b, version, 0, b.CreateVectorOfStructs(pages), count, payload.raw_bytes);
        },
        payload.bytes);
    try {
      apply(held, parse(packet));
    } catch (const StreamError& error) {
      EXPECT_TRUE(held.gaussians == replica.held().gaussians);
      EXPECT_EQ(held.visibility_version, 7U);
      return error.what();
    }
    return "nothing";
  };
  EXPECT_EQ(refusal(7, {{99}, {3}}, 1), "nothing");
  EXPECT_EQ(refusal(6, {{99}, {3}}, 1), "LightVisibility: of scene version 6 where 7 is held");
  EXPECT_EQ(refusal(8, {{100}, {3}}, 1), "LightVisibility: slot 100 of 100 held");
  EXPECT_NE(refusal(8, {{9}, {3}}, 2).find("LightVisibility: ends"), std::string::npos);
  EXPECT_NE(refusal(8, {{99}, {3, 3}}, 1).find("too many"), std::string::npos);
  EXPECT_NE(refusal(8, {{99}, {3}}, 101).find("101 Gaussians"), std::string::npos);
}

}  // namespace
}  // namespace splatbus::stream
