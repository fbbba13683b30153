// Those who mean harm: what they do is bounded, and a good browser's packets go on meanwhile.
#include <dirent.h>

#include <fstream>
#include <thread>

#include "gateway/packet_gate.h"
#include "gateway_fixture.h"

namespace splatbus::gateway_test {
namespace {

#ifdef __SANITIZE_ADDRESS__
constexpr std::size_t kGrowth = std::size_t{192} << 20;  // with redzones, and what is freed and kept
#else
constexpr std::size_t kGrowth = std::size_t{64} << 20;
#endif

using Frame = WebSocketClient;

std::size_t open_descriptors() {
  std::size_t count = 0;
  DIR* folder = ::opendir("/proc/self/fd");
  while (::readdir(folder) != nullptr) ++count;
  ::closedir(folder);
  return count;
}

std::size_t resident_bytes() {
  std::size_t all = 0, resident = 0;
  std::ifstream("/proc/self/statm") >> all >> resident;
  return resident * static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
}

class Hostile : public GatewayTest {
 protected:
  void start(const Settings& settings = {}) {
    start_with_fake(settings);
    good_ = std::make_unique<WebSocketClient>(port_);
    good_->send_packet(hello("good").packet);
    good_peer_ = fake_->receive().peer;
  }
  static stream::EncodedPacket probe() {
    return packet(wire::Body::Probe, [](auto& builder) {
      const wire::Camera camera;
      return wire::CreateProbe(builder, 1, &camera);
    });
  }
  /// A packet each way between the good browser and the streamer.
  void expect_good_one_served() {
    ASSERT_TRUE(fake_->send(good_peer_, {"p", "for the good one"}));
    EXPECT_EQ(page_text(*good_), "pfor the good one");
    good_->send_packet(pose().packet);
    EXPECT_EQ(fake_->receive().peer, good_peer_);
  }

  std::unique_ptr<WebSocketClient> good_;
  std::string good_peer_;
};

TEST_F(Hostile, WhatIsNoPacketEndsItsConnection) {
  start();
  const std::string valid = [] {
    const auto packet = pose();
    std::string text(4, '\0');
    text[0] = static_cast<char>(packet.packet.size());
    return text + text_of(packet.packet);
  }();
  struct Case {
    std::uint8_t opcode;
    std::string payload;
    int code;
  };
  for (const Case& bad :
       {Case{Frame::kText, "hello", 1008}, Case{Frame::kText, valid, 1007}, Case{Frame::kBinary, "", 1008},
        Case{Frame::kBinary, "abc", 1008}, Case{Frame::kBinary, std::string(100, '\xff'), 1008},
        Case{Frame::kBinary, std::string(100, '\0'), 1008},
        Case{Frame::kBinary, valid.substr(0, valid.size() - 1), 1008},
        Case{Frame::kBinary, std::string(65537, 'x'), 1009}, Case{3, "reserved", 1002},
        Case{Frame::kContinuation, "of nothing", 1002}, Case{Frame::kPing, std::string(126, 'x'), 1002}}) {
    WebSocketClient page(port_);
    ASSERT_TRUE(page.open());
    page.send_frame(bad.opcode, bad.payload);
    EXPECT_FALSE(page.receive());
    EXPECT_EQ(page.close_code(), bad.code) << bad.payload.substr(0, 20);
    EXPECT_TRUE(page.wire().ends());
    expect_good_one_served();  // and nothing else has come to the streamer
  }
}

TEST_F(Hostile, AMessageThatNeverEndsIsCutOff) {
  start({{"max_rate_kbps", "100000"}});
  WebSocketClient page(port_);
  const std::string piece(1000, 'x');
  bool sent = page.send_frame(Frame::kBinary, piece, false);
  for (int i = 0; i < 100 && sent; ++i) sent = page.send_frame(Frame::kContinuation, piece, false);
  EXPECT_FALSE(page.receive());
  EXPECT_EQ(page.close_code(), 1009);
  expect_good_one_served();
}

TEST_F(Hostile, UnmaskedFramesAreRefused) {
  start();
  WebSocketClient page(port_);
  page.wire().send(std::string("\x82\x05hello", 7));
  EXPECT_FALSE(page.receive());
  EXPECT_EQ(page.close_code(), 1002);
}

TEST_F(Hostile, AFloodOfPingsEndsIts) {
  start({{"max_messages_per_s", "20"}});
  WebSocketClient page(port_);
  for (int i = 0; i < 200; ++i) page.send_frame(Frame::kPing, "");
  EXPECT_TRUE(page.wire().ends());
  EXPECT_EQ(refused("flood"), 1);
  expect_good_one_served();
}

TEST_F(Hostile, MessagesAreReadAtTheirRate) {
  start({{"max_messages_per_s", "20"}});
  WebSocketClient page(port_);
  for (int i = 0; i < 60; ++i) page.send_packet(pose().packet);
  const auto began = std::chrono::steady_clock::now();
  std::string peer;
  for (int i = 0; i < 60; ++i) {
    const auto received = fake_->receive();
    ASSERT_EQ(received.frames.size(), 1U);
    EXPECT_TRUE(peer.empty() || peer == received.peer);
    peer = received.peer;
  }
  // 40 at once, the burst; the other 20 take a second. An upper bound would be a timing test.
  EXPECT_GE(std::chrono::steady_clock::now() - began, 900ms);
}

TEST_F(Hostile, BytesAreReadAtTheirRate) {
  start({{"max_rate_kbps", "800"}});  // 100 kB/s
  WebSocketClient page(port_);
  const auto began = std::chrono::steady_clock::now();
  const auto packet = pose();
  const std::vector<std::uint8_t> payload(60000, 1);
  for (int i = 0; i < 4; ++i) page.send_packet(packet.packet, payload);
  for (int i = 0; i < 4; ++i) ASSERT_EQ(fake_->receive().frames.size(), 2U);
  EXPECT_GE(std::chrono::steady_clock::now() - began, 1s) << "240 kB";
}

TEST_F(Hostile, ConnectionsAreBoundedAndComeBack) {
  start({{"max_connections", "12"}, {"handshake_s", "0.5"}});
  const std::size_t before = open_descriptors();
  std::vector<std::unique_ptr<WireClient>> half_open;
  for (int i = 0; i < 60; ++i) {
    half_open.push_back(std::make_unique<WireClient>(port_));
    half_open.back()->send("GET / HTTP/1.1\r\nHost");
  }
  expect_good_one_served();
  // What is refused is there until it is closed.
  EXPECT_TRUE(bus_test::eventually([&] { return open_descriptors() <= before + 60 + 12; })) << open_descriptors();
  for (const auto& client : half_open) EXPECT_TRUE(client->ends());
  half_open.clear();
  ASSERT_TRUE(bus_test::eventually([&] { return get(port_, "/status").status == 200; }));
  EXPECT_GE(refused("busy"), 60 - 11);
  EXPECT_TRUE(bus_test::eventually([&] { return status()["gateway"]["connections"] == 2; }));
  expect_good_one_served();
}

TEST_F(Hostile, OneAddressHasItsShareOnly) {
  start({{"max_connections", "100"}, {"max_connections_per_address", "3"}});
  WebSocketClient second(port_);
  WireClient third(port_), fourth(port_);
  EXPECT_TRUE(second.open());
  EXPECT_TRUE(fourth.ends());
  expect_good_one_served();
}

TEST_F(Hostile, ARequestThatTricklesIsCutOff) {
  start({{"handshake_s", "0.3"}});
  WireClient client(port_);
  // It never stops sending, and never comes to an end.
  bool ended = false;
  const auto deadline = std::chrono::steady_clock::now() + kPatience;
  client.send("GET / HTTP/1.1\r\nHost: localhost\r\n");
  while (!ended && std::chrono::steady_clock::now() < deadline) {
    client.send("A: b\r\n");
    ended = client.ends(20ms);
  }
  EXPECT_TRUE(ended);
}

TEST_F(Hostile, RequestsThatComeAllAtOnceAreAnsweredUpToABound) {
  start({{"max_rate_kbps", "100000"}});
  WireClient client(port_);
  std::thread sender([&] {
    std::string requests;
    for (int i = 0; i < 1200; ++i) requests += "GET /none HTTP/1.1\r\nHost: localhost\r\n\r\n";
    client.send(requests);
  });
  const std::string all = client.receive_rest();
  sender.join();
  std::size_t answers = 0;
  for (std::size_t at = all.find("HTTP/1.1 404"); at != std::string::npos; at = all.find("HTTP/1.1 404", at + 1)) {
    ++answers;
  }
  EXPECT_EQ(answers, 1000U) << "then they have to connect again";
  expect_good_one_served();
}

TEST_F(Hostile, UpgradesOneAfterTheOtherLeaveNothingBehind) {
  start({{"max_connections", "20"}});
  const std::size_t before = open_descriptors();
  for (int i = 0; i < 100; ++i) {
    WebSocketClient page(port_);
    if (page.open() && i % 2 == 0) page.send_frame(Frame::kBinary, "garbage");
  }
  expect_good_one_served();
  // At the latest when they have been silent for too long; then the good one, which answers no ping, has gone too.
  EXPECT_TRUE(bus_test::eventually([&] {
    const auto now = status();
    return now.is_object() && now["gateway"]["viewers"] <= 1 && now["gateway"]["connections"] <= 2;
  }));
  // The gateway's own connections to the bus may have come after the first count, on a busy machine.
  EXPECT_TRUE(bus_test::eventually([&] { return open_descriptors() <= before + 8; }))
      << open_descriptors() << " after 100 upgrades, " << before << " before";
}

TEST_F(Hostile, AnUpgradeIsNotFollowedByWhatItsAnswerHasNotAllowedYet) {
  start();
  const std::string upgrade =
      "GET /stream HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
      "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
      "Sec-WebSocket-Protocol: splatbus.stream.1\r\n\r\n";
  const HttpAnswer answer = ask(port_, upgrade + "GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n");
  EXPECT_EQ(answer.status, 400);
  EXPECT_EQ(answer.body, "too early\n");
  expect_good_one_served();
}

TEST_F(Hostile, WhoSaysNoMoreThanOneRequestGetsItsAnswer) {
  start();
  WireClient client(port_);
  client.send("GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n");
  client.end_sending();
  EXPECT_EQ(parse_answer(client.receive_rest()).status, 200);
  expect_good_one_served();
}

TEST_F(Hostile, ASilentBrowserIsLetGo) {
  start_with_fake({{"idle_s", "0.4"}});
  WebSocketClient silent(port_);
  // It answers no ping.
  EXPECT_TRUE(silent.wire().ends());
  EXPECT_TRUE(bus_test::eventually([&] { return status()["gateway"]["viewers"] == 0; }));
}

TEST_F(Hostile, WhoMayOnlyLookNeitherSteersNorProbes) {
  // printf %s abc | sha256sum
  const std::string tokens = write("tokens", "view ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start_with_fake({{"tokens", tokens}});
  WebSocketClient page(port_, {.target = "/stream?token=abc"});
  ASSERT_TRUE(page.open());
  page.send_packet(probe().packet);
  const auto posed = pose();
  page.send_packet(posed.packet);
  const auto received = fake_->receive();
  EXPECT_THAT(received.frames, testing::ElementsAre(text_of(posed.packet))) << "the first that came";
  EXPECT_EQ(received.rights, "rights view");
  EXPECT_EQ(status("Authorization: Bearer abc\r\n")["gateway"]["refused"]["forbidden"], 1);
}

TEST_F(Hostile, TheStreamerHeedsTheRightsOfABrowser) {
  // printf %s guest | sha256sum, and of pilot
  const std::string tokens = write("tokens",
                                   "view 84983c60f7daadc1cb8698621f802c0d9f9a3c3c295c810748fb048115c186ec\n"
                                   "view,steer 07ae38b93d8054d84aac37039c71ad114a8685a3857084d568f260ce69f0737f\n");
  std::filesystem::permissions(tokens, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  start_streamer();
  start_gateway(endpoint(), {{"tokens", tokens}});
  bus::Subscriber poses(connect("observer"), {"viewer/pose"});
  ASSERT_TRUE(poses.wait_connected(kPatience));
  for (const std::string name : {"guest", "pilot"}) {
    WebSocketClient page(port_, {.target = "/stream?token=" + name});
    ASSERT_TRUE(page.open());
    const auto greet = [&] {
      page.send_packet(hello(name).packet);
      for (auto body = wire::Body::NONE; body != wire::Body::Welcome;) {
        const auto message = page.receive();
        ASSERT_TRUE(message);
        const auto framed =
            stream::take_apart({reinterpret_cast<const std::uint8_t*>(message->data()), message->size()});
        body = stream::ParsedPacket::parse(framed.packet, framed.payload).body();
      }
    };
    greet();
    page.send_packet(pose().packet);
    greet();  // with its answer the pose, too, has been taken
  }
  const auto first = poses.receive(kPatience);
  ASSERT_TRUE(first);
  EXPECT_EQ(first->root<wire::ViewerPose>().viewer()->str(), "pilot");
}

TEST_F(Hostile, AllOfItAtOnceCostsLittle) {
  start({{"max_connections", "40"}, {"handshake_s", "0.5"}, {"stall_s", "0.5"}});
  const std::size_t descriptors = open_descriptors(), resident = resident_bytes();
  // The streamer's own queues, of 64 packets for each, are in this process too.
  const std::string big(65000, 'x'), payload(30000, 'y');
  std::mt19937 random(3);
  for (int round = 0; round < 6; ++round) {
    std::vector<std::unique_ptr<WireClient>> half_open;
    std::vector<std::unique_ptr<WebSocketClient>> pages;
    for (int i = 0; i < 20; ++i) {
      half_open.push_back(std::make_unique<WireClient>(port_));
      half_open.back()->send(i % 2 == 0
                                 ? "POST /bench HTTP/1.1\r\nHost: localhost\r\nContent-Length: 16000\r\n\r\n" + big
                                 : "GET /stream HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n");
    }
    for (int i = 0; i < 10; ++i) {
      WebSocketClient::Options slow;
      slow.wire.receive_buffer = 4096;
      auto page = std::make_unique<WebSocketClient>(port_, slow);
      if (!page->open()) continue;
      page->send_packet(hello().packet);
      const std::string peer = fake_->receive().peer;
      while (fake_->send(peer, {"p", payload})) {
      }
      page->send_frame(Frame::kBinary, big, false);
      std::string garbage(2000, '\0');
      for (char& byte : garbage) byte = static_cast<char>(random());
      page->wire().send(garbage);
      pages.push_back(std::move(page));
    }
    expect_good_one_served();
  }
  EXPECT_TRUE(bus_test::eventually([&] {
    const auto now = status();
    return now.is_object() && now["gateway"]["viewers"] == 1 && now["gateway"]["queued_bytes"] == 0;
  }));
  EXPECT_TRUE(bus_test::eventually([&] { return open_descriptors() <= descriptors + 4; }));
  EXPECT_LE(resident_bytes(), resident + kGrowth);
  expect_good_one_served();
}

}  // namespace
}  // namespace splatbus::gateway_test
