// What peers of a hub cost each other, whoever they are.
#include <gtest/gtest.h>

#include <limits>

#include "../../bus/bus_fixture.h"
#include "../../nanoseconds.h"
#include "../../stream/toy_server.h"
#include "stream/relay_client.h"
#include "streamer/viewer_hub.h"
#include "wire/convert.h"

namespace splatbus::streamer {
namespace {

/// A connection of its own; with a number, a gateway's client.
class Peer {
 public:
  Peer(zmq::context_t& context, const std::string& endpoint, std::uint64_t client = 0,
       const bus::ClientKeys* keys = nullptr)
      : socket_(context, zmq::socket_type::dealer), client_(client) {
    if (keys != nullptr) bus::use_keys(socket_, *keys);
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::sndhwm, 0);
    socket_.set(zmq::sockopt::rcvhwm, 0);
    socket_.connect(endpoint);
  }
  void say(wire::Body body, auto build, std::uint64_t epoch = 0) {
    const auto packet = writer_.write(epoch, 0, body, build);
    if (client_ != 0) {
      socket_.send(zmq::buffer(bus::rights_frame(bus::Rights::all())), zmq::send_flags::sndmore);
      socket_.send(zmq::buffer(stream::client_frame(client_)), zmq::send_flags::sndmore);
    }
    socket_.send(zmq::buffer(packet.packet), zmq::send_flags::none);
  }
  void hello(const std::string& name = "viewer", const wire::Camera* camera = nullptr) {
    say(wire::Body::Hello, [&](auto& b) {
      const auto text = b.CreateString(name);
      wire::HelloBuilder hello(b);
      hello.add_viewer(text);
      if (camera != nullptr) hello.add_camera(camera);
      return hello.Finish();
    });
  }
  void bye() {
    say(wire::Body::Bye, [](auto& b) { return wire::CreateByeDirect(b, "over"); });
  }
  void pose(std::uint32_t width = 64, std::uint32_t height = 48) {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, width, height, 1));
    say(wire::Body::Pose, [&](auto& b) { return wire::CreatePose(b, &camera); });
  }
  void probe(std::uint64_t id, std::uint32_t width, std::uint32_t height) {
    const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, width, height, 1));
    say(wire::Body::Probe, [&](auto& b) { return wire::CreateProbe(b, id, &camera); });
  }
  /// Pages, or a manifest.
  void ask(const std::vector<wire::PageVersion>& pages, bool manifest, std::uint64_t epoch = 0) {
    say(
        wire::Body::PageRequest,
        [&](auto& b) { return wire::CreatePageRequest(b, manifest, b.CreateVectorOfStructs(pages)); }, epoch);
  }
  /// Packets of that kind that are there.
  int read(wire::Body kind) {
    int count = 0;
    zmq::message_t packet, payload;
    while (socket_.recv(packet, zmq::recv_flags::dontwait)) {
      if (packet.more()) (void)socket_.recv(payload);
      count += stream::ParsedPacket::parse({packet.data<std::uint8_t>(), packet.size()},
                                           {payload.data<std::uint8_t>(), payload.size()})
                           .body() == kind
                   ? 1
                   : 0;
    }
    return count;
  }

 private:
  zmq::socket_t socket_;
  std::uint64_t client_;
  stream::PacketWriter writer_{"viewer", 1};
};

class HubPeersTest : public testing::Test {
 protected:
  bool are_let_in_or_refused(const std::vector<std::unique_ptr<Peer>>& all) {
    std::size_t refused = 0;
    return receive_until([&] {
      for (const auto& one : all) refused += static_cast<std::size_t>(one->read(wire::Body::Bye));
      return hub_.viewers() + refused == all.size();
    });
  }

  HubPeersTest() : HubPeersTest(EndpointOptions{}) {}
  explicit HubPeersTest(const EndpointOptions& options)
      : endpoint_({"ipc://" + directory_.path() + "/streamer", "tcp://127.0.0.1:*"}, options) {
    EXPECT_TRUE(model_.observe(stream::test::toy_model(20'000, 1).view()));
    model_.reset_to_target();
    hub_.restart_all();
  }
  [[nodiscard]] std::unique_ptr<Peer> peer(std::uint64_t client = 0) {
    return std::make_unique<Peer>(context_, endpoint_.bound()[0], client);
  }
  bool receive_until(const std::function<bool()>& done) {
    return bus_test::eventually([&] { return hub_.receive(now_ns_), done(); });
  }

  static constexpr std::size_t kPlaces = 8, kPlacesOfOne = 3;
  static constexpr double kKbps = 1000;
  bus_test::TemporaryDirectory directory_;
  zmq::context_t context_;
  Endpoint endpoint_;
  stream::StreamModel model_{stream::PacketWriter("streamer", 1), 77, stream::StreamOptions{}};
  std::uint64_t poses_ = 0, probes_ = 0;
  ViewerHub hub_{endpoint_, model_, stream::PacketWriter("streamer", 1),
                 HubOptions{.max_viewers = kPlaces, .max_viewers_per_address = kPlacesOfOne, .viewer_kbps = kKbps},
                 HubEvents{.pose = [this](const auto&, const auto&) { ++poses_; },
                           .probe = [this](const auto&, const auto&) { ++probes_; },
                           .quality = {}}};
  std::int64_t now_ns_ = kSecond;
};

TEST_F(HubPeersTest, AGoodViewerJoinsBesideOneThatNeverSaysHello) {
  const auto noisy = peer(), good = peer();
  std::uint64_t asked = 0;
  const auto answered = [&] { return asked += static_cast<std::uint64_t>(noisy->read(wire::Body::Welcome)); };
  const auto babble = [&](std::uint64_t count) {
    const std::uint64_t before = hub_.ignored();
    asked = 0;
    for (std::uint64_t k = 0; k < count; ++k) {
      noisy->say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    }
    // All of it: what waits yet would take its turn beside the good one's word.
    return receive_until([&] { return hub_.ignored() >= before + count - answered(); });
  };
  ASSERT_TRUE(babble(1000));
  // It has spoken already whenever the good one says Hello, and a second of that is enough.
  for (int tenth = 0; tenth < 10 && hub_.viewers() == 0; ++tenth) {
    now_ns_ += kSecond / 10;
    ASSERT_TRUE(babble(500));
    const std::uint64_t ignored = hub_.ignored();
    good->hello();
    ASSERT_TRUE(receive_until([&] { return hub_.viewers() == 1 || hub_.ignored() > ignored; }));
  }
  EXPECT_EQ(hub_.viewers(), 1U);
}

TEST_F(HubPeersTest, OneAddressHoldsSoManyPlaces) {
  std::vector<std::unique_ptr<Peer>> all;
  for (std::size_t k = 0; k < kPlaces; ++k) {
    all.push_back(peer(7));
    all.back()->hello();
  }
  ASSERT_TRUE(are_let_in_or_refused(all));
  EXPECT_EQ(hub_.viewers(), kPlacesOfOne);
  const auto other = peer(8);
  other->hello();
  EXPECT_TRUE(receive_until([&] { return hub_.viewers() == kPlacesOfOne + 1; })) << "of another address";
  // This user's own processes are no address.
  for (std::size_t k = 0; k < 4; ++k) {
    all.push_back(peer());
    all.back()->hello();
  }
  EXPECT_TRUE(receive_until([&] { return hub_.viewers() == kPlaces; }));
}

TEST_F(HubPeersTest, OverPlainTcpThisMachineIsTrustedAsOverIpc) {
  std::vector<std::unique_ptr<Peer>> all;
  for (std::uint64_t k = 1; k <= kPlacesOfOne + 1; ++k) {
    for (const std::uint64_t client : {std::uint64_t{0}, k}) {  // itself, and a gateway's clients
      all.push_back(std::make_unique<Peer>(context_, endpoint_.bound()[1], client));
      all.back()->hello();
    }
  }
  ASSERT_EQ(all.size(), kPlaces);
  EXPECT_TRUE(receive_until([&] { return hub_.viewers() == kPlaces; }));
  all.push_back(std::make_unique<Peer>(context_, endpoint_.bound()[1]));
  all.back()->ask({}, true);
  ASSERT_TRUE(receive_until([&] { return all.back()->read(wire::Body::Manifest) > 0; }));
}

/// A server's key, and one that may only look.
struct Keys {
  Keys() {
    bus::write_key_file(options.keys.key, server);
    bus::write_allow_list(options.keys.allowed, {{"somebody", client.public_key, {.view = true}}});
  }

  bus_test::TemporaryDirectory folder;
  EndpointOptions options{
      .keys = {.key = folder.path() + "/server.key", .allowed = folder.path() + "/allowed", .always = true}};
  bus::KeyPair server = bus::make_key_pair(), client = bus::make_key_pair();
};

/// Over tcp with that.
class KeyedHubPeersTest : private Keys, public HubPeersTest {
 protected:
  KeyedHubPeersTest() : HubPeersTest(options), keys_{client, server.public_key} {}

  bus::ClientKeys keys_;
};

TEST_F(KeyedHubPeersTest, WhoMayOnlyLookIsOneAddressWhoeverItNames) {
  std::vector<std::unique_ptr<Peer>> all;
  for (std::uint64_t k = 1; k <= kPlaces; ++k) {
    all.push_back(std::make_unique<Peer>(context_, endpoint_.bound()[1], k, &keys_));
    all.back()->hello();
  }
  ASSERT_TRUE(are_let_in_or_refused(all));
  EXPECT_EQ(hub_.viewers(), kPlacesOfOne);
}

/// Joins, is sent what there is, and leaves, again and again: bytes that were sent in `cycles` of a twentieth second.
std::uint64_t bytes_of_cycles(int cycles, const std::function<Peer&()>& next, ViewerHub& hub, std::int64_t& now_ns,
                              bool new_names = false) {
  (void)hub.statistics().close_window(now_ns);
  for (int k = 0; k < cycles; ++k) {
    Peer& peer = next();
    peer.hello(new_names ? "viewer " + std::to_string(k) : "viewer");
    EXPECT_TRUE(bus_test::eventually([&] { return hub.receive(now_ns), hub.viewers() == 1; }));
    for (int step = 0; step < 5; ++step) hub.pump(now_ns += kSecond / 100);
    peer.bye();
    EXPECT_TRUE(bus_test::eventually([&] { return hub.receive(now_ns), hub.viewers() == 0; }));
  }
  return hub.statistics().close_window(now_ns).bytes;
}

TEST_F(HubPeersTest, HelloAndByeBringNoBytesBeyondTheRate) {
  constexpr int kCycles = 4;
  constexpr double kAllowed = kKbps * 125 * (0.1 + 0.05 * kCycles) + 1000 * kCycles;  // and Welcomes
  const auto same = peer();
  EXPECT_LE(static_cast<double>(bytes_of_cycles(
                kCycles, [&]() -> Peer& { return *same; }, hub_, now_ns_)),
            kAllowed);
  now_ns_ += 20 * kSecond;
  std::vector<std::unique_ptr<Peer>> others;
  const auto another = [&]() -> Peer& { return *others.emplace_back(peer(7)); };
  EXPECT_LE(static_cast<double>(bytes_of_cycles(kCycles, another, hub_, now_ns_)), kAllowed)
      << "by other connections of one address";
}

TEST_F(HubPeersTest, NewNamesBringNoBytesBeyondTheRate) {
  constexpr int kCycles = 12;
  constexpr double kAllowed = kKbps * 125 * (0.1 * (1 + PeerBook::kForgiven + 1) + 0.05 * kCycles) + 1000 * kCycles;
  std::vector<std::unique_ptr<Peer>> others;
  const auto another = [&]() -> Peer& { return *others.emplace_back(peer(7)); };
  EXPECT_LE(static_cast<double>(bytes_of_cycles(kCycles, another, hub_, now_ns_, true)), kAllowed);
}

// A greeting that makes no sense is refused before what it owes is taken from the book.
TEST_F(HubPeersTest, AGreetingThatMakesNoSensePaysNoDebts) {
  const auto same = peer();
  wire::Camera nowhere = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
  nowhere.mutate_fx(std::numeric_limits<float>::quiet_NaN());
  for (int k = 0; k < 3; ++k) {
    same->hello();
    ASSERT_TRUE(receive_until([&] { return hub_.viewers() == 1; }));
    const std::uint64_t ignored = hub_.ignored();
    same->pose();
    same->say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    ASSERT_TRUE(receive_until([&] { return hub_.ignored() > ignored; })) << "what it said has been heard";
    same->bye();
    ASSERT_TRUE(receive_until([&] { return hub_.viewers() == 0; }));
    if (k < 2) same->hello("viewer", &nowhere);  // it has five greetings
  }
  EXPECT_EQ(poses_, 1U) << "in no time at all";
}

TEST_F(HubPeersTest, AScreenMayBeLargerThanAProbe) {
  const auto one = peer();
  const wire::Camera screen = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 7680, 4320, 1));
  one->hello("viewer", &screen);
  ASSERT_TRUE(receive_until([&] { return hub_.viewers() == 1; }));
  one->pose(6016, 3384);
  ASSERT_TRUE(receive_until([&] { return poses_ == 1; }));
  one->probe(1, 8192, 2049);
  one->probe(2, 8192, 2048);
  ASSERT_TRUE(receive_until([&] { return probes_ > 0; }));
  one->say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
  ASSERT_TRUE(receive_until([&] { return hub_.ignored() > 0; }));
  EXPECT_EQ(probes_, 1U) << "somebody else would render that";
}

TEST_F(HubPeersTest, HelloAndByeBringNoPosesBeyondTheHubsPace) {
  const auto same = peer();
  for (int k = 0; k < 4; ++k) {
    same->hello("phantom " + std::to_string(k));
    ASSERT_TRUE(receive_until([&] { return hub_.viewers() == 1; }));
    const std::uint64_t ignored = hub_.ignored();
    same->pose();
    same->say(wire::Body::Quality, [](auto& b) { return wire::CreateQuality(b, 1); });
    ASSERT_TRUE(receive_until([&] { return hub_.ignored() > ignored; })) << "what it said has been heard";
    same->bye();
    ASSERT_TRUE(receive_until([&] { return hub_.viewers() == 0; }));
  }
  EXPECT_EQ(poses_, 1U) << "in no time at all";
}

TEST_F(HubPeersTest, AnEmptyPageRequestKeepsNothingGoing) {
  const auto one = peer();
  const std::uint64_t ignored = hub_.ignored();
  one->ask({}, false);
  ASSERT_TRUE(receive_until([&] { return hub_.ignored() > ignored; }));
  EXPECT_FALSE(hub_.is_followed());
  one->ask({}, true);
  ASSERT_TRUE(receive_until([&] { return one->read(wire::Body::Manifest) > 0; }));
  EXPECT_TRUE(hub_.is_followed()) << "one of this user's own, such as a gateway";
}

TEST_F(KeyedHubPeersTest, StrangersReadLittleAndShutNoGatewayOut) {
  std::vector<std::unique_ptr<Peer>> strangers;
  std::vector<wire::PageVersion> pages;
  for (const stream::OfferedPage& page : *model_.offered()) pages.emplace_back(page.page, page.version);
  ASSERT_GE(pages.size(), 16U);
  pages.resize(16);
  const std::uint64_t epoch = model_.status().epoch;
  for (int k = 0; k < 20; ++k) {
    strangers.push_back(std::make_unique<Peer>(context_, endpoint_.bound()[1], 0, &keys_));
    strangers.back()->ask(pages, false, epoch);
  }
  int given = 0;
  const auto given_so_far = [&] {
    for (const auto& one : strangers) given += one->read(wire::Body::Page);
    return given;
  };
  ASSERT_TRUE(receive_until([&] { return given_so_far() >= 16 && hub_.ignored() >= 19; }));
  EXPECT_EQ(given_so_far(), 16);
  EXPECT_FALSE(hub_.is_followed());
  const auto gateway = peer();
  gateway->ask(pages, false, epoch);
  int got = 0;
  EXPECT_TRUE(receive_until([&] { return (got += gateway->read(wire::Body::Page)) == 16; }));
}

}  // namespace
}  // namespace splatbus::streamer
