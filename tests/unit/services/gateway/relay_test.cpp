// What browsers and streamer get from each other.
#include <sys/stat.h>

#include "gateway/packet_gate.h"
#include "gateway_fixture.h"
#include "stream/replica.h"
#include "viewer/packet_link.h"

namespace splatbus::gateway_test {
namespace {

using testing::ElementsAre;

/// A browser that follows the stream.
class Follower {
 public:
  explicit Follower(std::uint16_t port, std::string name = "page") : name_(std::move(name)), socket_(port) { greet(); }

  /// Takes packets until `done`, says what has come, and greets a streamer that asks for it or is silent; false after a
  /// patience.
  bool until(const std::function<bool()>& done) {
    const auto deadline = std::chrono::steady_clock::now() + kPatience;
    while (!done()) {
      if (std::chrono::steady_clock::now() > deadline) return false;
      const auto message = socket_.receive(200ms);
      acknowledge();
      if (!message) {
        greet();
        continue;
      }
      const auto framed = stream::take_apart({reinterpret_cast<const std::uint8_t*>(message->data()), message->size()});
      const auto packet = stream::ParsedPacket::parse(framed.packet, framed.payload);
      if (packet.body() == wire::Body::Welcome) newest_ = said_ = 0;
      newest_ = std::max(newest_, packet.sequence());
      if (packet.body() == wire::Body::Welcome && packet.root().body_as_Welcome()->asks()) greet();
      replica_.receive(packet);
    }
    return true;
  }
  [[nodiscard]] const stream::Replica& replica() const { return replica_; }
  [[nodiscard]] WebSocketClient& socket() { return socket_; }

  /// That what was sent up to `newest` has come.
  void say_held(std::uint64_t newest) {
    const auto held = stream::PacketWriter(name_, 1).write(
        replica_.epoch(), 0, wire::Body::Held, [&](auto& builder) { return wire::CreateHeldDirect(builder, newest); });
    socket_.send_packet(held.packet);
  }

 private:
  void acknowledge() {
    const auto now = std::chrono::steady_clock::now();
    if (newest_ == said_ || now - said_at_ < 50ms) return;
    said_ = newest_;
    said_at_ = now;
    say_held(newest_);
  }
  void greet() {
    const auto hello = stream::PacketWriter(name_, 1).write(0, 0, wire::Body::Hello, [&](auto& builder) {
      return wire::CreateHelloDirect(builder, name_.c_str(), nullptr, false, 0);
    });
    socket_.send_packet(hello.packet);
  }

  std::string name_;
  WebSocketClient socket_;
  stream::Replica replica_;
  std::uint64_t newest_ = 0, said_ = 0;
  std::chrono::steady_clock::time_point said_at_;
};

class Relay : public GatewayTest {};

TEST_F(Relay, ABrowserHoldsTheModelThatTheStreamerServes) {
  start_streamer();
  start_gateway(endpoint());
  trainer_.publish(stream::test::toy_model(3000, 1));
  Follower page(port_);
  ASSERT_TRUE(page.socket().open());
  ASSERT_TRUE(page.until([&] { return page.replica().count() == 3000 && page.replica().missing_pages() == 0; }));
  trainer_.publish(stream::test::toy_model(3500, 1));
  EXPECT_TRUE(page.until([&] { return page.replica().count() == 3500; }));
}

TEST_F(Relay, TheStreamerIsToldWhoseConnectionsAreOfOneAddress) {
  FakeStreamer& streamer = start_with_fake();
  WebSocketClient first(port_), second(port_);
  first.send_packet(hello().packet);
  const std::string client = streamer.receive().client;
  EXPECT_TRUE(stream::parse_client_frame(client)) << client;
  second.send_packet(hello().packet);
  EXPECT_EQ(streamer.receive().client, client);
}

TEST_F(Relay, NobodyConnectsWhereOthersMayHavePutASocket) {
  const std::string open = directory_.path() + "/open";
  ASSERT_EQ(::mkdir(open.c_str(), 0700), 0);
  ASSERT_EQ(::chmod(open.c_str(), 0777), 0);
  zmq::context_t context;
  EXPECT_THROW(gateway::StreamLink(context, "ipc://" + open + "/streamer"), bus::Error);
  EXPECT_THROW((void)viewer::make_zmq_link("ipc://" + open + "/streamer", "", ""), bus::Error);
}

TEST_F(Relay, ABrowserThatCannotBeLinkedIsToldSo) {
  const std::string folder = directory_.path() + "/open";
  ASSERT_EQ(::mkdir(folder.c_str(), 0700), 0);
  const FakeStreamer streamer(folder);
  start_gateway(streamer.endpoint());
  ASSERT_EQ(::chmod(folder.c_str(), 0777), 0);
  WebSocketClient page(port_);
  ASSERT_TRUE(page.open());
  EXPECT_FALSE(page.receive());
  EXPECT_EQ(page.close_code(), 1008);
  EXPECT_TRUE(page.wire().ends()) << "so that it tries again";
}

TEST_F(Relay, ManyBrowsersHoldIt) {
  start_streamer();
  start_gateway(endpoint());
  trainer_.publish(stream::test::toy_model(500, 1));
  std::vector<std::unique_ptr<Follower>> pages;
  for (int i = 0; i < 20; ++i) pages.push_back(std::make_unique<Follower>(port_, "page " + std::to_string(i)));
  for (const auto& page : pages) EXPECT_TRUE(page->until([&] { return page->replica().count() == 500; }));
  EXPECT_EQ(status()["gateway"]["viewers"], 20);
}

TEST_F(Relay, OneThatStopsReadingHarmsNoneOfTwenty) {
  start_streamer();
  start_gateway(endpoint(), {{"stall_s", "0.5"}});
  trainer_.publish(stream::test::toy_model(500, 1));
  std::vector<std::unique_ptr<Follower>> pages;
  for (int i = 0; i < 20; ++i) pages.push_back(std::make_unique<Follower>(port_, "page " + std::to_string(i)));
  WebSocketClient::Options slow;
  slow.wire.receive_buffer = 4096;
  WebSocketClient stopped(port_, slow);
  stopped.send_packet(hello("stopped").packet);
  const std::uint64_t epoch = [&] {
    EXPECT_TRUE(pages[0]->until([&] { return pages[0]->replica().count() == 500; }));
    return pages[0]->replica().epoch();
  }();
  // The model grows by more than all buffers on its way hold, until it has been let go of; it lies about what has come.
  std::size_t count = 500;
  ASSERT_TRUE(bus_test::eventually([&] {
    count += 1000;
    trainer_.publish(stream::test::toy_model(count, static_cast<std::uint32_t>(count)));
    for (const auto& page : pages) EXPECT_TRUE(page->until([&] { return page->replica().count() == count; }));
    const auto lie = [](auto& builder) { return wire::CreateHeldDirect(builder, ~std::uint64_t{0}); };
    stopped.send_packet(packet(wire::Body::Held, lie, epoch).packet);
    return refused("stalled") == 1;
  }));
  EXPECT_TRUE(bus_test::eventually([&] { return status()["gateway"]["viewers"] == 20; }));
}

TEST_F(Relay, OnTheWayToABrowserThatStopsReadingIsLittle) {
  constexpr double kKbps = 9000;
  start_streamer({{"viewer_kbps", "9000"}});
  start_gateway(endpoint(), {{"stall_s", "3600"}});
  trainer_.publish(stream::test::toy_model(20'000, 1));
  Follower page(port_);
  ASSERT_TRUE(page.until([&] { return page.replica().count() == 20'000 && page.replica().missing_pages() == 0; }));
  bus::Subscriber stats(connect("observer"), {"stream/stats"});
  std::vector<std::uint64_t> sent;  // to all, each second
  // All of the model changes, again and again.
  for (std::uint32_t seed = 2; sent.size() < 5; ++seed) {
    trainer_.publish(stream::test::toy_model(20'000, seed));
    page.socket().send_packet(pose().packet);
    if (const auto message = stats.receive(50ms)) {
      sent.push_back(message->root<wire::StreamStats>("StreamStats/2").total_bytes());
    }
  }
  EXPECT_LE(static_cast<double>(sent.back() - sent.front()), kKbps * 125) << "a second's worth, of four";
  trainer_.publish(stream::test::toy_model(20'500, 1));
  EXPECT_TRUE(page.until([&] { return page.replica().count() == 20'500 && page.replica().missing_pages() == 0; }));
}

TEST_F(Relay, AStreamerThatComesBackIsFoundByTheSameConnection) {
  start_streamer();
  start_gateway(endpoint());
  trainer_.publish(stream::test::toy_model(300, 1));
  Follower page(port_);
  ASSERT_TRUE(page.until([&] { return page.replica().count() == 300; }));
  const std::uint64_t epoch = page.replica().epoch();
  kill_streamer();
  start_streamer();
  EXPECT_TRUE(page.until([&] { return page.replica().epoch() != epoch && page.replica().count() == 300; }));
}

TEST_F(Relay, BytesArePassedOnAsTheyAre) {
  FakeStreamer& streamer = start_with_fake();
  WebSocketClient page(port_);
  ASSERT_TRUE(page.open());
  EXPECT_EQ(page.answer().field("Sec-WebSocket-Protocol"), "splatbus.stream.1");
  const auto greeting = hello();
  page.send_packet(greeting.packet);
  const auto received = streamer.receive();
  EXPECT_THAT(received.frames, ElementsAre(text_of(greeting.packet)));
  EXPECT_EQ(received.rights, "rights view,steer,probe,control") << "without tokens";
  // Longer than one TCP segment and one read; and every byte there is.
  std::string payload(300000, '\0');
  for (std::size_t i = 0; i < payload.size(); ++i) payload[i] = static_cast<char>(i * 7 + i / 251);
  ASSERT_TRUE(streamer.send(received.peer, {"a packet", payload}));
  ASSERT_TRUE(streamer.send(received.peer, {"alone"}));
  EXPECT_TRUE(page.receive() == std::string("\x08\0\0\0a packet", 12) + payload);
  EXPECT_EQ(page.receive(), std::string("\x05\0\0\0alone", 9));
}

TEST_F(Relay, APayloadOfABrowserIsAFrameOfItsOwn) {
  FakeStreamer& streamer = start_with_fake();
  WebSocketClient page(port_);
  const auto greeting = hello();
  const std::vector<std::uint8_t> payload{1, 2, 3};
  page.send_packet(greeting.packet, payload);
  EXPECT_THAT(streamer.receive().frames, ElementsAre(text_of(greeting.packet), "\x01\x02\x03"));
}

TEST_F(Relay, EachBrowserIsAPeerOfItsOwnAndGoesWithIt) {
  FakeStreamer& streamer = start_with_fake();
  auto first = std::make_unique<WebSocketClient>(port_);
  WebSocketClient second(port_);
  first->send_packet(hello("first").packet);
  const std::string one = streamer.receive().peer;
  second.send_packet(hello("second").packet);
  const std::string two = streamer.receive().peer;
  EXPECT_NE(one, two);
  first.reset();
  EXPECT_TRUE(bus_test::eventually([&] { return !streamer.send(one, {"are you there?"}); }));
  EXPECT_TRUE(streamer.send(two, {"you are"}));
  EXPECT_EQ(page_text(second), "you are");
}

TEST_F(Relay, TheStreamerIsReadNoFurtherThanTheBrowserReads) {
  FakeStreamer& streamer = start_with_fake({{"stall_s", "3600"}});
  WebSocketClient::Options slow;
  slow.wire.receive_buffer = 4096;
  WebSocketClient page(port_, slow);
  page.send_packet(hello().packet);
  const std::string peer = streamer.receive().peer;
  const std::string payload(100000, 'x');
  // Refused for good only when every buffer on the way is full.
  int sent = 0;
  bool full = false;
  while (!full && sent < 2000) {
    if (streamer.send(peer, {"p", payload})) {
      ++sent;
    } else {
      full = !bus_test::eventually([&] { return streamer.send(peer, {"p", payload}); }, 300ms);
      if (!full) ++sent;
    }
  }
  EXPECT_TRUE(full);
  EXPECT_LT(sent, 200) << "64 at the streamer, 8 in the gateway's link, the rest in the kernel";
  // Nothing of it is lost when he reads again.
  for (int i = 0; i < sent; ++i) ASSERT_EQ(page.receive()->size(), payload.size() + 5) << i;
}

TEST_F(Relay, OneThatTakesNothingIsClosedAndHarmsNobody) {
  FakeStreamer& streamer = start_with_fake({{"stall_s", "0.3"}});
  WebSocketClient::Options slow;
  slow.wire.receive_buffer = 4096;
  WebSocketClient stopped(port_, slow), good(port_);
  stopped.send_packet(hello("stopped").packet);
  const std::string stopped_peer = streamer.receive().peer;
  good.send_packet(hello("good").packet);
  const std::string good_peer = streamer.receive().peer;
  const std::string payload(100000, 'x');
  // Until the gateway has let go of it, whose queue is full before.
  ASSERT_TRUE(bus_test::eventually([&] {
    while (streamer.send(stopped_peer, {"p", payload})) {
    }
    EXPECT_TRUE(streamer.send(good_peer, {"q", "for the good one"}));
    EXPECT_EQ(page_text(good), "qfor the good one");
    return refused("stalled") == 1;
  }));
  EXPECT_TRUE(bus_test::eventually([&] { return status()["gateway"]["viewers"] == 1; }));
  EXPECT_EQ(status()["gateway"]["queued_bytes"], 0);
}

TEST_F(Relay, AllThatIsBeingWrittenIsBoundedTogether) {
  FakeStreamer& streamer = start_with_fake({{"stall_s", "3600"}, {"max_queued_mb", "8"}});
  WebSocketClient::Options slow;
  slow.wire.receive_buffer = 4096;
  const std::string payload(std::size_t{6} << 20, 'x');
  WebSocketClient first(port_, slow), second(port_, slow);
  std::vector<std::string> peers;
  for (WebSocketClient* page : {&first, &second}) {
    page->send_packet(hello().packet);
    peers.push_back(streamer.receive().peer);
    ASSERT_TRUE(streamer.send(peers.back(), {"p", payload}));
    ASSERT_TRUE(bus_test::eventually([&] { return status()["gateway"]["queued_bytes"] > 0; }));
  }
  EXPECT_TRUE(bus_test::eventually([&] { return refused("stalled") == 1; }));
  EXPECT_FALSE(first.receive()) << "it has taken longest";
  EXPECT_EQ(second.receive()->size(), payload.size() + 5);
}

}  // namespace
}  // namespace splatbus::gateway_test
