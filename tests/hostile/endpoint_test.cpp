// What strangers do to the streamer's endpoint, by hand where libzmq would not.
#include "streamer/endpoint.h"

#include <gmock/gmock.h>
#include <sys/resource.h>
#include <unistd.h>

#include <thread>
#include <vector>

#include "../unit/bus/bus_fixture.h"
#include "budgets.h"
#include "bus/error.h"
#include "raw_zmtp.h"

namespace splatbus::hostile {
namespace {

using bus_test::eventually;
using streamer::Endpoint;
using streamer::EndpointOptions;
using testing::HasSubstr;
using testing::ThrowsMessage;
using namespace std::chrono_literals;

constexpr std::size_t kFrame = 60000;

/// An endpoint on tcp that a thread reads, as the hub does.
class ServedEndpoint {
 public:
  explicit ServedEndpoint(const std::string& address = "tcp://127.0.0.1:*", const EndpointOptions& options = {})
      : endpoint_({address}, options), thread_([this](const std::stop_token& stop) { run(stop); }) {}

  [[nodiscard]] std::string address() const {
    const std::string& bound = endpoint_.bound().front();
    return "tcp://127.0.0.1:" + bound.substr(bound.rfind(':') + 1);
  }
  [[nodiscard]] int packets() const { return packets_; }
  [[nodiscard]] bus::ConnectionGuard::Counts connections() const { return endpoint_.connections(); }
  [[nodiscard]] bus::Rights rights() const {
    const std::scoped_lock lock(mutex_);
    return rights_;
  }

 private:
  void run(const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      zmq_pollitem_t item{endpoint_.socket(), 0, ZMQ_POLLIN, 0};
      zmq_poll(&item, 1, 20);
      while (const auto received = endpoint_.receive()) {
        const std::scoped_lock lock(mutex_);
        rights_ = received->rights;
        ++packets_;
      }
    }
  }

  Endpoint endpoint_;
  mutable std::mutex mutex_;
  bus::Rights rights_;
  std::atomic<int> packets_ = 0;
  std::jthread thread_;
};

stream::Bytes hello() {
  return stream::PacketWriter("viewer", 1)
      .write(1, 0, wire::Body::Hello, [](auto& b) { return wire::CreateHelloDirect(b, "x"); })
      .packet;
}

/// A viewer as libzmq makes them.
class Dealer {
 public:
  explicit Dealer(const std::string& address, const bus::ClientKeys* keys = nullptr)
      : socket_(context_, zmq::socket_type::dealer) {
    socket_.set(zmq::sockopt::linger, 0);
    socket_.set(zmq::sockopt::immediate, true);
    if (keys != nullptr) bus::use_keys(socket_, *keys);
    socket_.connect(address);
  }
  void say_hello() { (void)socket_.send(zmq::buffer(hello()), zmq::send_flags::dontwait); }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
};

bool is_heard(ServedEndpoint& endpoint, Dealer& dealer, std::chrono::milliseconds timeout = bus_test::patience) {
  const int before = endpoint.packets();
  return eventually(
      [&] {
        dealer.say_hello();
        return endpoint.packets() > before;
      },
      timeout);
}

TEST(HostileEndpoint, AMessageWithoutAnEndIsEndedAndItsMemoryGivenBack) {
  ServedEndpoint endpoint;
  Dealer good(endpoint.address());
  ASSERT_TRUE(is_heard(endpoint, good));
  const std::size_t before = resident_bytes(::getpid());
  RawZmtp raw(endpoint.address());
  ASSERT_TRUE(raw.handshake("DEALER"));
  const std::string part(kFrame, 'x');
  std::size_t sent = 0;
  while (sent < 1000 * kMiB && raw.send_frame(part, true)) sent += part.size();
  EXPECT_LT(sent, 200 * kMiB) << "nobody ended it";
  EXPECT_TRUE(raw.closed_within(1s));
  EXPECT_LT(resident_bytes(::getpid()), before + 64 * kMiB);
  EXPECT_TRUE(is_heard(endpoint, good));
  EXPECT_GE(endpoint.connections().closed, 1U);
}

TEST(HostileEndpoint, AFrameLargerThanAViewerHasToSayEndsTheConnection) {
  ServedEndpoint endpoint;
  RawZmtp raw(endpoint.address());
  ASSERT_TRUE(raw.handshake("DEALER"));
  ASSERT_TRUE(raw.send_frame_head(std::size_t{1} << 30, false));
  EXPECT_TRUE(raw.closed_within(3s));
}

// libzmq answers a PING of a connection that is gone by the end of the process, if a full queue kept it from being
// read.
TEST(HostileEndpoint, APingBehindManyMessagesAndAResetEndNothing) {
  ServedEndpoint endpoint;
  Dealer good(endpoint.address());
  for (int round = 0; round < 50; ++round) {
    RawZmtp raw(endpoint.address());
    ASSERT_TRUE(raw.handshake("DEALER"));
    send_messages_and_pings(raw, "x");
    raw.reset();
  }
  EXPECT_TRUE(is_heard(endpoint, good));
}

// The streamer is busy: what waits takes memory, though its sender has said a word.
TEST(HostileEndpoint, WhoSaysMoreThanIsReadIsClosed) {
  Endpoint endpoint({"tcp://127.0.0.1:*"}, {});
  RawZmtp raw(endpoint.bound().front());
  ASSERT_TRUE(raw.handshake("DEALER"));
  const stream::Bytes word = hello();
  ASSERT_TRUE(raw.send_frame(std::string(word.begin(), word.end()), false));
  ASSERT_TRUE(eventually([&] { return endpoint.receive().has_value(); }));
  const std::string many(32 * 1024, '\0');  // empty frames, each of them 64 bytes in memory
  std::size_t sent = 0;
  while (sent < 10 * kMiB && raw.send_bytes(many)) {
    sent += many.size();
    (void)endpoint.receive();  // some of it
    std::this_thread::sleep_for(10ms);
  }
  EXPECT_LT(sent, 4 * kMiB) << "what was never read was taken for read";
}

// The streamer is busy, and one after the other says a little and leaves, or is closed for having said too much.
TEST(HostileEndpoint, WhatThoseHaveSaidWhoAreGoneIsBoundedToo) {
  const stream::Bytes word = hello();
  for (const std::size_t bytes : {std::size_t{64} << 10, std::size_t{1} << 20}) {
    Endpoint endpoint({"tcp://127.0.0.1:*"}, {});
    std::string many;
    while (many.size() < bytes) {
      many += '\0';
      many += static_cast<char>(word.size());  // a short frame
      many.append(word.begin(), word.end());
    }
    const auto end = std::chrono::steady_clock::now() + 2s;
    for (int i = 0; i < 2000 && std::chrono::steady_clock::now() < end; ++i) {
      auto raw = RawZmtp::try_connect(endpoint.bound().front());
      if (raw && raw->handshake("DEALER")) raw->send_bytes(many);
    }
    std::size_t waits = 0;
    while (endpoint.receive()) ++waits;
    EXPECT_GT(waits, 0U);
    EXPECT_LT(waits * word.size(), 16 * kMiB) << "of those that said " << bytes << " each";
    Dealer good(endpoint.bound().front());
    EXPECT_TRUE(eventually([&] {
      good.say_hello();
      return endpoint.receive().has_value();
    }));
  }
}

TEST(HostileEndpoint, WhoNeverSaysAWordIsClosed) {
  ServedEndpoint endpoint;
  std::vector<RawZmtp> silent;  // one after the handshake, one before it, one before the greeting
  for (int i = 0; i < 3; ++i) silent.emplace_back(endpoint.address());
  ASSERT_TRUE(silent[0].handshake("DEALER"));
  ASSERT_TRUE(silent[1].greet());
  for (RawZmtp& raw : silent) EXPECT_TRUE(raw.closed_within(8s));
  EXPECT_TRUE(eventually([&] { return endpoint.connections().open == 0; }));
}

TEST(HostileEndpoint, AThousandConnectionsKeepNobodyElseOut) {
  ServedEndpoint endpoint;
  const std::size_t before = open_descriptors(::getpid());
  std::vector<RawZmtp> many;
  for (int i = 0; i < 1000; ++i) many.emplace_back(endpoint.address());
  ASSERT_TRUE(eventually([&] { return endpoint.connections().closed >= 744 && endpoint.connections().open <= 256; }));
  const std::size_t ours = many.size();
  EXPECT_TRUE(eventually([&] { return open_descriptors(::getpid()) < before + ours + 2 * 256 + 50; }));
  many.clear();
  Dealer good(endpoint.address());
  EXPECT_TRUE(is_heard(endpoint, good));
}

// libzmq takes the last one for the connection, and there is none for who bounds it.
TEST(HostileEndpoint, WhoTakesTheLastDescriptorDoesNotStay) {
  ServedEndpoint endpoint;
  rlimit limit{};
  ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &limit), 0);
  const rlimit few{.rlim_cur = 200, .rlim_max = limit.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<bus::FileDescriptor> taken;
  for (int fd = 0; (fd = ::dup(STDOUT_FILENO)) >= 0;) taken.emplace_back(fd);
  taken.resize(taken.size() - 2);  // the peer's own, and libzmq's
  {
    RawZmtp raw(endpoint.address());
    EXPECT_TRUE(raw.closed_within(3s)) << "nobody looks at what it says";
  }
  taken.clear();
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &limit), 0);
  Dealer good(endpoint.address());
  EXPECT_TRUE(is_heard(endpoint, good));
}

TEST(HostileEndpoint, OtherTransportsAreRefusedByName) {
  for (const char* transport : {"ws", "wss", "pgm", "epgm", "norm", "udp", "tipc", "vmci", "inproc"}) {
    EXPECT_THAT([&] { Endpoint({std::string(transport) + "://127.0.0.1:7600"}); },
                ThrowsMessage<bus::Error>(HasSubstr(std::string(transport) + " is not spoken here")));
  }
  EXPECT_THROW(Endpoint({"7600"}), bus::Error);
}

/// A folder with a server's key, an allow-list and keys of clients.
class KeyedEndpoint : public testing::Test {
 protected:
  KeyedEndpoint() : server_(bus::make_key_pair()), client_(bus::make_key_pair()) {
    bus::write_key_file(options_.keys.key, server_);
  }

  void allow(const bus::Rights& rights) {
    bus::write_allow_list(options_.keys.allowed, {{"somebody", client_.public_key, rights}});
  }
  [[nodiscard]] bus::ClientKeys client_keys() const { return {client_, server_.public_key}; }

  bus_test::TemporaryDirectory directory_;
  EndpointOptions options_{
      .keys = {.key = directory_.path() + "/server.key", .allowed = directory_.path() + "/allowed", .always = true}};
  bus::KeyPair server_, client_;
};

TEST_F(KeyedEndpoint, AKeyThatIsAllowedSpeaksWithItsRights) {
  allow({.view = true, .probe = true});
  ServedEndpoint endpoint("tcp://127.0.0.1:*", options_);
  const auto keys = client_keys();
  Dealer viewer(endpoint.address(), &keys);
  ASSERT_TRUE(is_heard(endpoint, viewer));
  EXPECT_EQ(endpoint.rights(), (bus::Rights{.view = true, .probe = true}));
  // Read again when it changes.
  allow({.view = true, .steer = true});
  EXPECT_TRUE(eventually([&] {
    viewer.say_hello();
    return endpoint.rights() == bus::Rights{.view = true, .steer = true};
  }));
}

TEST_F(KeyedEndpoint, NobodyElseGetsAWordIn) {
  allow({.view = true});
  ServedEndpoint endpoint("tcp://127.0.0.1:*", options_);
  const bus::ClientKeys stranger{bus::make_key_pair(), server_.public_key};
  const bus::ClientKeys wrong_server{client_, bus::make_key_pair().public_key};
  Dealer unknown(endpoint.address(), &stranger), misled(endpoint.address(), &wrong_server), plain(endpoint.address());
  for (Dealer* dealer : {&unknown, &misled, &plain}) EXPECT_FALSE(is_heard(endpoint, *dealer, 300ms));
  RawZmtp raw(endpoint.address());
  EXPECT_FALSE(raw.handshake("DEALER"));
  // And costs nothing: the bytes of a handshake that never comes to an end are bounded.
  const std::size_t before = resident_bytes(::getpid());
  RawZmtp curve(endpoint.address());
  ASSERT_TRUE(curve.greet("CURVE"));
  const std::string part(kFrame, 'x');
  std::size_t sent = 0;
  while (sent < 100 * kMiB && curve.send_frame(part, true)) sent += part.size();
  EXPECT_LT(sent, 100 * kMiB);
  EXPECT_LT(resident_bytes(::getpid()), before + 16 * kMiB);
  EXPECT_EQ(endpoint.packets(), 0);
}

TEST_F(KeyedEndpoint, ARevokedKeyIsShutOutAtOnce) {
  allow({.view = true});
  ServedEndpoint endpoint("tcp://127.0.0.1:*", options_);
  const auto keys = client_keys();
  Dealer viewer(endpoint.address(), &keys);
  ASSERT_TRUE(is_heard(endpoint, viewer));
  bus::write_allow_list(options_.keys.allowed, {});
  ASSERT_TRUE(eventually([&] { return endpoint.connections().closed >= 1; })) << "it need not say anything";
  EXPECT_FALSE(is_heard(endpoint, viewer, 300ms));
}

TEST_F(KeyedEndpoint, AListThatOthersCanWriteLetsNobodyIn) {
  allow({.view = true});
  ASSERT_EQ(::chmod(options_.keys.allowed.c_str(), 0622), 0);
  ServedEndpoint endpoint("tcp://127.0.0.1:*", options_);
  const auto keys = client_keys();
  Dealer viewer(endpoint.address(), &keys);
  EXPECT_FALSE(is_heard(endpoint, viewer, 300ms));
}

TEST_F(KeyedEndpoint, WhatOthersCanReachTakesAKey) {
  options_.keys = {.key = directory_.path() + "/none", .allowed = directory_.path() + "/allowed"};
  EXPECT_THAT(
      [&] { Endpoint({"tcp://*:*"}, options_); },
      ThrowsMessage<bus::Error>(testing::AllOf(HasSubstr("needs a key"), HasSubstr("splatbus keys new server"))));
  options_.keys.key = directory_.path() + "/server.key";
  ServedEndpoint endpoint("tcp://*:*", options_);
  Dealer plain(endpoint.address());
  EXPECT_FALSE(is_heard(endpoint, plain, 300ms));
}

}  // namespace
}  // namespace splatbus::hostile
