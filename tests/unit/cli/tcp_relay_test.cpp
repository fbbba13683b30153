#include "tcp_relay.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cstddef>
#include <string>
#include <thread>
#include <vector>

#include "../nanoseconds.h"
#include "bus/clock.h"
#include "network_link.h"

namespace splatbus::cli {
namespace {

constexpr int kPatienceMs = 60'000;

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

/// Reads until `bytes` have come, the other end has closed, or the patience is over.
std::string read_some(int fd, std::size_t bytes) {
  std::string text;
  std::array<char, 65536> buffer;
  while (text.size() < bytes) {
    pollfd item{fd, POLLIN, 0};
    if (::poll(&item, 1, kPatienceMs) != 1) break;
    const ssize_t got = ::recv(fd, buffer.data(), std::min(buffer.size(), bytes - text.size()), 0);
    if (got <= 0) break;
    text.append(buffer.data(), static_cast<std::size_t>(got));
  }
  return text;
}

bool has_ended(int fd) {
  char byte = 0;
  pollfd item{fd, POLLIN, 0};
  return ::poll(&item, 1, kPatienceMs) == 1 && ::recv(fd, &byte, 1, 0) <= 0;
}

bool can_be_read(int fd) {
  pollfd item{fd, POLLIN, 0};
  return ::poll(&item, 1, 0) == 1;
}

std::string pattern(std::size_t bytes) {
  std::string text(bytes, 0);
  for (std::size_t i = 0; i < bytes; ++i) text[i] = static_cast<char>((i * 131 + i / 251) % 256);
  return text;
}

class TcpRelayTest : public testing::Test {
 protected:
  TcpRelayTest() : listener_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address = loopback(0);
    socklen_t bytes = sizeof address;
    auto* generic = reinterpret_cast<sockaddr*>(&address);
    EXPECT_EQ(::bind(listener_.get(), generic, bytes), 0);
    EXPECT_EQ(::listen(listener_.get(), 8), 0);
    EXPECT_EQ(::getsockname(listener_.get(), generic, &bytes), 0);
    server_port_ = ntohs(address.sin_port);
  }

  static bus::FileDescriptor connect_to(std::uint16_t port) {
    bus::FileDescriptor client(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const sockaddr_in address = loopback(port);
    EXPECT_EQ(::connect(client.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    return client;
  }

  /// The server's end of what came through the relay.
  bus::FileDescriptor accept_one() {
    pollfd item{listener_.get(), POLLIN, 0};
    EXPECT_EQ(::poll(&item, 1, kPatienceMs), 1);
    return bus::FileDescriptor(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC));
  }

  bus::FileDescriptor listener_;
  std::uint16_t server_port_ = 0;
};

TEST_F(TcpRelayTest, PassesEveryByteBothWaysAndTheEnd) {
  TcpRelay relay(server_port_, {.round_trip_ms = 4, .mbps = 400, .loss = 0.05}, 3);
  const bus::FileDescriptor client = connect_to(relay.port());
  const bus::FileDescriptor server = accept_one();
  const std::string up = pattern(3000), down = pattern(1'000'000);
  ASSERT_EQ(::send(client.get(), up.data(), up.size(), 0), static_cast<ssize_t>(up.size()));
  EXPECT_EQ(read_some(server.get(), up.size()), up);
  std::thread sender([&] {
    EXPECT_EQ(::send(server.get(), down.data(), down.size(), 0), static_cast<ssize_t>(down.size()));
    ::shutdown(server.get(), SHUT_WR);
  });
  EXPECT_EQ(read_some(client.get(), down.size()), down);
  sender.join();
  EXPECT_TRUE(has_ended(client.get()));
  ::shutdown(client.get(), SHUT_WR);
  EXPECT_TRUE(has_ended(server.get()));
}

TEST_F(TcpRelayTest, TakesItsTimeForTheWayAndTheBytes) {
  const LinkShape shape{.round_trip_ms = 200, .mbps = 4};
  TcpRelay relay(server_port_, shape);
  const std::int64_t begun_ns = bus::now_ns();
  const bus::FileDescriptor client = connect_to(relay.port());
  const bus::FileDescriptor server = accept_one();
  EXPECT_GE(bus::now_ns() - begun_ns, 200 * kMs) << "a connection takes a round trip";
  const std::int64_t asked_ns = bus::now_ns();
  ASSERT_EQ(::send(client.get(), "ask", 3, 0), 3);
  EXPECT_EQ(read_some(server.get(), 3), "ask");
  EXPECT_GE(bus::now_ns() - asked_ns, 100 * kMs);
  // 200,000 bytes at 4 Mbit/s are 0.4 s, and the last of them 0.1 s on the way.
  const std::string text = pattern(200'000);
  const std::int64_t sent_ns = bus::now_ns();
  std::thread sender(
      [&] { EXPECT_EQ(::send(server.get(), text.data(), text.size(), 0), static_cast<ssize_t>(text.size())); });
  EXPECT_EQ(read_some(client.get(), text.size()), text);
  EXPECT_GE(bus::now_ns() - sent_ns, 500 * kMs);
  sender.join();
}

TEST_F(TcpRelayTest, ASenderWaitsForASlowLink) {
  TcpRelay relay(server_port_, {.mbps = 0.1});
  const bus::FileDescriptor client = connect_to(relay.port());
  const bus::FileDescriptor server = accept_one();
  const int small = 1 << 16;
  ::setsockopt(server.get(), SOL_SOCKET, SO_SNDBUF, &small, sizeof small);
  // 16 MiB would take 22 minutes: only what fits the buffers on the way is taken, however long one tries.
  const std::string text = pattern(1 << 20);
  std::size_t taken = 0;
  const std::int64_t end_ns = bus::now_ns() + kSecond;
  while (bus::now_ns() < end_ns && taken < std::size_t{16} << 20) {
    const ssize_t put = ::send(server.get(), text.data(), text.size(), MSG_DONTWAIT);
    if (put > 0) taken += static_cast<std::size_t>(put);
    pollfd item{server.get(), POLLOUT, 0};
    ::poll(&item, 1, 50);
  }
  EXPECT_LT(taken, std::size_t{2} << 20);
}

TEST_F(TcpRelayTest, NothingPassesInACutAndEverythingAfterIt) {
  TcpRelay relay(server_port_, {});
  const bus::FileDescriptor client = connect_to(relay.port());
  const bus::FileDescriptor server = accept_one();
  ASSERT_EQ(::send(client.get(), "before", 6, 0), 6);
  EXPECT_EQ(read_some(server.get(), 6), "before");

  const LinkCut cut{.from_ns = bus::now_ns(), .to_ns = bus::now_ns() + kSecond};
  relay.cut(cut);
  ASSERT_EQ(::send(client.get(), "within", 6, 0), 6);
  // Another that is tried meanwhile comes about with a try after it.
  const bus::FileDescriptor late_client = connect_to(relay.port());
  ASSERT_EQ(::send(late_client.get(), "late", 4, 0), 4);
  EXPECT_EQ(read_some(server.get(), 6), "within");
  EXPECT_GE(bus::now_ns(), cut.to_ns);
  const bus::FileDescriptor late_server = accept_one();
  EXPECT_GE(bus::now_ns(), cut.to_ns);
  EXPECT_EQ(read_some(late_server.get(), 4), "late");
  EXPECT_FALSE(can_be_read(client.get()));
}

TEST_F(TcpRelayTest, ABrokenServerEndsTheClientsConnection) {
  TcpRelay relay(server_port_, {});
  const bus::FileDescriptor client = connect_to(relay.port());
  accept_one().reset();
  EXPECT_TRUE(has_ended(client.get()));
  listener_.reset();
  const bus::FileDescriptor refused = connect_to(relay.port());
  EXPECT_TRUE(has_ended(refused.get())) << "nobody listens behind the relay";
}

TEST(NetworkLinkTest, WithoutNetemARelayShapesItAndSaysWhy) {
  const std::unique_ptr<NetworkLink> asked = make_link(LinkKind::Relay, {.round_trip_ms = 10}, 1);
  EXPECT_EQ(asked->text(), "relay: any rate, 10 ms round trip");
  const std::unique_ptr<NetworkLink> found = make_link(LinkKind::Auto, {.round_trip_ms = 10}, 1);
  if (found->text().starts_with("netem")) GTEST_SKIP() << "this machine has it: " << found->text();
  EXPECT_TRUE(found->text().starts_with("relay (")) << found->text();
  EXPECT_NE(found->endpoint(), "tcp://127.0.0.1:1");
}

}  // namespace
}  // namespace splatbus::cli
