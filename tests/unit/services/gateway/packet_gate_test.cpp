// What of a browser's messages goes on, and what is refused whatever its bytes are.
#include "gateway/packet_gate.h"

#include <random>

#include "gateway_fixture.h"
#include "stream/bytes.h"

namespace splatbus::gateway_test {
namespace {

using bus::Rights;
using gateway::Passage;

class PacketGate : public GatewayTest {
 protected:
  static Passage pass(const stream::EncodedPacket& packet, const Rights& rights) {
    return gateway::examine({.packet = packet.packet, .payload = packet.payload}, rights);
  }
};

TEST_F(PacketGate, FramingIsALengthAndWhatFollows) {
  const std::vector<std::uint8_t> message{3, 0, 0, 0, 10, 11, 12, 13, 14};
  const auto framed = stream::take_apart(message);
  EXPECT_THAT(framed.packet, testing::ElementsAre(10, 11, 12));
  EXPECT_THAT(framed.payload, testing::ElementsAre(13, 14));
  EXPECT_TRUE(stream::take_apart(std::span(message).first(7)).payload.empty());
  for (const std::vector<std::uint8_t>& wrong :
       std::vector<std::vector<std::uint8_t>>{{},
                                              {1},
                                              {1, 0, 0, 0},
                                              {0, 0, 0, 0, 9},
                                              {2, 0, 0, 0, 9},
                                              {1, 1, 0, 0, 9},
                                              {255, 255, 255, 255, 9},
                                              {252, 255, 255, 255, 9, 9, 9, 9}}) {
    EXPECT_THROW(static_cast<void>(stream::take_apart(wrong)), stream::StreamError);
  }
}

TEST_F(PacketGate, RightsDecideByTheBody) {
  const auto probe = packet(wire::Body::Probe, [](auto& builder) {
    const wire::Camera camera;
    return wire::CreateProbe(builder, 1, &camera);
  });
  const auto quality =
      packet(wire::Body::Quality, [](auto& builder) { return wire::CreateQuality(builder, 1, 40, 1, 0, 9, 1); });
  const auto held = packet(wire::Body::Held, [](auto& builder) { return wire::CreateHeld(builder, 1); });
  const auto bye = packet(wire::Body::Bye, [](auto& builder) { return wire::CreateByeDirect(builder, "ends"); });
  const Rights view{.view = true}, steer{.view = true, .steer = true}, may_probe{.view = true, .probe = true};
  for (const auto& any : {hello(), pose(), held, bye}) EXPECT_EQ(pass(any, view), Passage::Pass);
  for (const auto& asks : {probe, quality}) {
    EXPECT_EQ(pass(asks, view), Passage::Forbidden);
    EXPECT_EQ(pass(asks, steer), Passage::Forbidden);
    EXPECT_EQ(pass(asks, may_probe), Passage::Pass);
    EXPECT_EQ(pass(asks, Rights::all()), Passage::Pass);
  }
}

TEST_F(PacketGate, AnyChangeOfAPacketIsRefusedOrHarmless) {
  std::mt19937 random(1);
  const auto original = pose();
  int passed = 0, refused = 0;
  for (int i = 0; i < 20000; ++i) {
    stream::EncodedPacket changed = original;
    for (unsigned n = 1 + random() % 3; n > 0; --n) {
      changed.packet[random() % changed.packet.size()] = static_cast<std::uint8_t>(random());
    }
    if (random() % 4 == 0) changed.packet.resize(1 + random() % changed.packet.size());
    try {
      static_cast<void>(pass(changed, Rights()));
      ++passed;
    } catch (const stream::StreamError&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 1000);
  EXPECT_GT(passed, 1000);
}

}  // namespace
}  // namespace splatbus::gateway_test
