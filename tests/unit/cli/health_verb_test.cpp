#include <gmock/gmock.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <thread>

#include "../bus/bus_fixture.h"
#include "bus/file_descriptor.h"
#include "run_verb.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;

class HealthVerb : public bus_test::BusTest {
 protected:
  std::string run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"health", "--bus", directory_.address().text()});
    return run_verb(add_health_verb, std::move(arguments));
  }
  std::string error_of(std::vector<std::string> arguments) {
    try {
      return "no error, but: " + run(std::move(arguments));
    } catch (const std::exception& error) {
      return error.what();
    }
  }
};

TEST_F(HealthVerb, OfTheBusAndOfWhoIsOnIt) {
  EXPECT_EQ(run({"--timeout", "60"}), "the bus is alive\n");
  EXPECT_EQ(run({"bus", "--timeout", "60"}), "bus is alive\n") << "which does not list itself";
  EXPECT_EQ(error_of({"trainer", "--timeout", "3"}), "trainer is not on the bus");
  broker_->stop();
  EXPECT_THAT(error_of({}), HasSubstr("no bus at "));
}

TEST_F(HealthVerb, OfAPortAndAPage) {
  const bus::FileDescriptor listener(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in name{};
  name.sin_family = AF_INET;
  name.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof name;
  ASSERT_EQ(::bind(listener.get(), reinterpret_cast<sockaddr*>(&name), size), 0);
  ASSERT_EQ(::getsockname(listener.get(), reinterpret_cast<sockaddr*>(&name), &size), 0);
  const std::string place = "127.0.0.1:" + std::to_string(ntohs(name.sin_port));
  EXPECT_EQ(error_of({"--tcp", place}), place + " is not healthy") << "it is bound, and nobody listens";
  ASSERT_EQ(::listen(listener.get(), 4), 0);
  EXPECT_EQ(run({"--tcp", place}), place + " answers\n");
  EXPECT_EQ(error_of({"--http", "http://" + place + "/", "--timeout", "0.3"}), "http://" + place + "/ is not healthy")
      << "a port that is open says nothing of what is behind it";
  const std::jthread page([&](const std::stop_token& stop) {
    const std::stop_callback ends(stop, [&] { ::shutdown(listener.get(), SHUT_RD); });
    for (;;) {
      const bus::FileDescriptor peer(::accept(listener.get(), nullptr, nullptr));
      if (!peer.valid()) return;
      char request[512];
      const ssize_t got = ::recv(peer.get(), request, sizeof request, 0);
      if (got <= 0) continue;  // those of before
      const std::string answer = "HTTP/1.1 200 OK\r\n\r\n";
      EXPECT_GT(::send(peer.get(), answer.data(), answer.size(), MSG_NOSIGNAL), 0);
      if (std::string(request, static_cast<std::size_t>(got)).starts_with("GET /ready ")) return;
    }
  });
  EXPECT_EQ(run({"--http", "http://" + place + "/ready", "--timeout", "60"}), "http://" + place + "/ready answers\n");
  EXPECT_THROW(run({"--http", place}), CLI::ValidationError);
  EXPECT_THROW(run({"bus", "--tcp", place}), CLI::ExcludesError);
}

}  // namespace
}  // namespace splatbus::cli
