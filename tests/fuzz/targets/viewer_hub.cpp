// What viewers say to a streamer, in any order and at any time, with sockets that are full or gone: a sequence of
// steps, each begun by a byte. The hub is the streamer's own; of its endpoint this file has another one, without
// sockets, which is linked in that one's place.
#include "streamer/viewer_hub.h"

#include <spdlog/spdlog.h>

#include <deque>

#include "target.h"
#include "toy_stream.h"
#include "wire/convert.h"

namespace {

using splatbus::fuzz::require;
using Sent = splatbus::streamer::Endpoint::Sent;
namespace stream = splatbus::stream;
namespace wire = splatbus::wire;

struct Sockets {
  std::deque<splatbus::streamer::Endpoint::Received> said;
  std::map<std::string, Sent> answers;  ///< those that do not say Yes
  std::uint64_t sent = 0;
};
Sockets& sockets() {
  static Sockets all;
  return all;
}

}  // namespace

namespace splatbus::streamer {

Endpoint::Endpoint(const std::vector<std::string>&, const EndpointOptions&) {}

Endpoint::Sent Endpoint::send(const Peer& peer, const WirePacket& packet, std::uint64_t) {
  ++sockets().sent;
  require(packet.bytes() > 0, "a packet");
  const auto answer = sockets().answers.find(peer);
  return answer == sockets().answers.end() ? Sent::Yes : answer->second;
}

std::optional<Endpoint::Received> Endpoint::receive() {
  if (sockets().said.empty()) return std::nullopt;
  Received first = std::move(sockets().said.front());
  sockets().said.pop_front();
  return first;
}

}  // namespace splatbus::streamer

namespace {

constexpr std::size_t kMaxViewers = 3;

class Run {
 public:
  explicit Run(splatbus::fuzz::Input input)
      : input_(input), changes_(input_.number() % 4 == 0), own_(changes_ ? std::make_unique<Toy>() : nullptr) {
    sockets() = {};
    spdlog::set_level(spdlog::level::off);
  }

  void go() {
    for (int steps = 0; !input_.empty() && steps < 200; ++steps) {
      step(input_.number());
      hub_.receive(now_ns_);
      hub_.pump(now_ns_);
      require(hub_.viewers() <= kMaxViewers, "no more viewers than are served");
    }
    // Whoever is silent from now on is forgotten.
    now_ns_ += 60'000'000'000;
    hub_.expire(now_ns_);
    require(hub_.viewers() == 0 && hub_.followed_pages().empty(), "nothing is left of viewers that are gone");
  }

 private:
  using Toy = splatbus::fuzz::ToyStream;

  /// One that nothing changes costs nothing to have.
  Toy& toy() {
    static Toy still;
    return own_ ? *own_ : still;
  }
  [[nodiscard]] std::string peer(unsigned choice) const { return {static_cast<char>('a' + choice % 5)}; }

  void say(unsigned choice, const stream::EncodedPacket& packet) { say(choice, packet.packet); }
  void say(unsigned choice, splatbus::fuzz::Bytes packet) {
    try {
      auto rights = splatbus::bus::Rights::all();
      rights.probe = choice % 7 != 0;
      rights.steer = choice % 3 != 0;
      sockets().said.push_back(
          {.peer = peer(choice), .packet = stream::ParsedPacket::parse(packet, {}), .rights = rights});
    } catch (const stream::StreamError&) {  // refused by the endpoint
    }
  }
  template <class Build>
  void say(unsigned choice, wire::Body body, const Build& build) {
    const std::uint64_t epoch = input_.number() % 4 == 0 ? input_.number<std::uint64_t>() : Toy::kEpoch;
    say(choice, Toy::writer().write(epoch, 0, body, build));
  }
  wire::Camera camera() {
    wire::Camera camera = splatbus::to_wire(splatbus::look_at({0, 1, 3}, {0, 0, 0}, 64, 64, 1));
    const auto bytes = input_.take(input_.number() % (sizeof(camera) + 1));
    if (!bytes.empty()) std::memcpy(&camera, bytes.data(), bytes.size());
    return camera;
  }
  std::vector<wire::PageVersion> pages() {
    std::vector<wire::PageVersion> all(input_.number() % 8);
    for (auto& page : all) page = {input_.number(), input_.number()};
    return all;
  }

  void say_something(unsigned choice, unsigned kind) {
    switch (kind) {
      case 0:
        say(choice, wire::Body::Hello, [&](auto& builder) {
          const wire::Camera from = camera();
          const auto held = pages();
          const auto most = input_.number() % 2 == 0 ? 0U : input_.number<std::uint16_t>();
          return wire::CreateHelloDirect(builder, "viewer", &from, true, most, &held, input_.number(), input_.number());
        });
        break;
      case 1:
        say(choice, wire::Body::Held, [&](auto& builder) {
          std::vector<wire::SequenceRange> missing(input_.number() % 6);
          for (auto& range : missing) range = {input_.number(), input_.number()};
          if (!missing.empty() && input_.number() % 4 == 0) missing[0] = {0, input_.number<std::uint64_t>()};
          const auto lacks = pages();
          std::vector<std::uint32_t> dropped(input_.number() % 4);
          for (auto& page : dropped) page = input_.number();
          const auto newest = input_.number() % 4 == 0 ? input_.number<std::uint64_t>() : input_.number();
          return wire::CreateHeldDirect(builder, newest, &missing, input_.number<std::uint64_t>(),
                                        input_.number<std::uint32_t>(), &lacks, &dropped, input_.number() % 2 == 0);
        });
        break;
      case 2:
        say(choice, wire::Body::Pose, [&](auto& builder) {
          const wire::Camera from = camera();
          return wire::CreatePose(builder, &from);
        });
        break;
      case 3:
        say(choice, wire::Body::Probe, [&](auto& builder) {
          const wire::Camera from = camera();
          return wire::CreateProbe(builder, input_.number(), &from);
        });
        break;
      case 4:
        say(choice, wire::Body::Quality, [&](auto& builder) { return wire::CreateQuality(builder, input_.number()); });
        break;
      case 5:
        say(choice, wire::Body::Bye, [&](auto& builder) { return wire::CreateByeDirect(builder, "x"); });
        break;
      default:
        say(choice, input_.take(input_.number<std::uint16_t>()));
    }
  }

  void step(unsigned kind) {
    const unsigned choice = input_.number();
    switch (kind % 16) {
      case 8:
        now_ns_ += std::int64_t{input_.number<std::uint16_t>()} * 1'000'000;
        break;
      case 9:
        hub_.send_keepalive(now_ns_);
        hub_.expire(now_ns_);
        break;
      case 10:
        hub_.send_probe_picture(input_.number(), Toy::welcome());
        break;
      case 11:
        sockets().answers.clear();
        if (choice / 5 % 3 != 0) sockets().answers[peer(choice)] = choice / 5 % 3 == 1 ? Sent::Full : Sent::Gone;
        break;
      case 12:
        hub_.set_rates(choice % 2 == 0 ? 0 : 100.0 * choice, 300.0 * (choice % 3));
        break;
      case 13:
        if (changes_) hub_.add(toy().tick());
        break;
      case 14:
        if (!changes_) break;
        if (const auto scene = toy().move()) hub_.add_scene(*scene);
        hub_.add_visibility(toy().see(static_cast<std::uint8_t>(choice)));
        break;
      case 15:
        if (choice % 8 == 0) hub_.restart_all();
        break;
      default:
        say_something(choice, kind % 16);
    }
  }

  splatbus::fuzz::Input input_;
  bool changes_;
  std::unique_ptr<Toy> own_;
  std::int64_t now_ns_ = 1'000'000'000'000;
  splatbus::streamer::Endpoint endpoint_{{}};
  splatbus::streamer::ViewerHub hub_{endpoint_,
                                     toy().model(),
                                     Toy::writer(),
                                     {.max_viewers = kMaxViewers, .history_bytes = std::size_t{1} << 16},
                                     {.pose = [](const auto&, const auto&) {},
                                      .probe = [](const auto&, const auto&) {},
                                      .quality = [](const auto&, const auto&) {}}};
};

}  // namespace

SPLATBUS_FUZZ_TARGET(viewer_hub, bytes) {
  Run(splatbus::fuzz::Input(bytes)).go();
}
