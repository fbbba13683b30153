// What a viewer is sent, by whoever says that he is a streamer: packets as a PacketLog has them, each with the
// follower's own words and what would be drawn after it. The first byte chooses whether a join went before.
#include "stream/follower.h"

#include "stream/display_gaussians.h"
#include "target.h"
#include "toy_stream.h"

namespace {

namespace stream = splatbus::stream;
using splatbus::fuzz::require;

constexpr std::int64_t kTurnNs = 60'000'000;
constexpr std::size_t kMaxGaussians = 20'000;

/// Takes what is said and drawn.
class Viewer {
 public:
  void receive(splatbus::fuzz::Bytes packet, splatbus::fuzz::Bytes payload) {
    now_ns_ += kTurnNs;
    try {
      follower_.receive(packet, payload, now_ns_);
    } catch (const std::runtime_error&) {  // refused
    }
    while (const auto said = follower_.next_outgoing(now_ns_)) {
      (void)stream::ParsedPacket::parse(said->packet, said->payload);
    }
    const stream::Replica& replica = follower_.replica();
    require(replica.count() <= 2 * kMaxGaussians, "no more Gaussians than it takes");
    shown_.apply(follower_.replica().take_changes());
    require(shown_.count() >= replica.count(), "what is held is shown");
    while (follower_.take_probe_answer()) {
    }
    (void)follower_.take_notice();
  }

 private:
  std::int64_t now_ns_ = 1;
  stream::Follower follower_{
      {.name = "viewer", .probes = true, .max_gaussians = kMaxGaussians, .held_picture_bytes = std::size_t{1} << 20},
      1};
  stream::DisplayGaussians shown_;
};

}  // namespace

SPLATBUS_FUZZ_TARGET(follower, bytes) {
  static const std::vector<stream::EncodedPacket> join = splatbus::fuzz::ToyStream().join();
  splatbus::fuzz::Input input(bytes);
  Viewer viewer;
  if (input.number() % 2 == 1) {
    for (const auto& packet : join) viewer.receive(packet.packet, packet.payload);
  }
  while (!input.empty()) {
    const auto packet_bytes = input.number<std::uint32_t>(), payload_bytes = input.number<std::uint32_t>();
    const auto packet = input.take(packet_bytes);
    viewer.receive(packet, input.take(payload_bytes));
  }
}
