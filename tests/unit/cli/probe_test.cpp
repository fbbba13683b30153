// Probes of launch files: what is asked, and what the supervisor does about it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <fstream>

#include "bus/file_descriptor.h"
#include "probe_runner.h"
#include "supervisor_fixture.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;

bool eventually(const std::function<bool()>& holds) {
  for (const auto end = std::chrono::steady_clock::now() + kPatience; std::chrono::steady_clock::now() < end;) {
    if (holds()) return true;
    std::this_thread::sleep_for(5ms);
  }
  return false;
}

/// Answers every connection on a port of the loopback address with `answer()`.
class Answerer {
 public:
  explicit Answerer(std::function<std::string()> answer)
      : socket_(::socket(AF_INET, SOCK_STREAM, 0)), answer_(std::move(answer)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<sockaddr*>(&address), size), 0);
    EXPECT_EQ(::listen(socket_.get(), 8), 0);
    EXPECT_EQ(::getsockname(socket_.get(), reinterpret_cast<sockaddr*>(&address), &size), 0);
    place_ = "127.0.0.1:" + std::to_string(ntohs(address.sin_port));
    thread_ = std::thread([this] {
      while (true) {
        const bus::FileDescriptor peer(::accept(socket_.get(), nullptr, nullptr));
        if (peer.get() < 0) return;
        char request[512];
        if (::recv(peer.get(), request, sizeof request, 0) <= 0) continue;
        const std::string text = answer_();
        static_cast<void>(::send(peer.get(), text.data(), text.size(), MSG_NOSIGNAL));
      }
    });
  }
  ~Answerer() {
    ::shutdown(socket_.get(), SHUT_RDWR);
    thread_.join();
  }
  [[nodiscard]] const std::string& place() const { return place_; }

 private:
  bus::FileDescriptor socket_;
  std::function<std::string()> answer_;
  std::string place_;
  std::thread thread_;
};

Probe probe(Probe::Kind kind, std::string target, std::vector<std::string> command = {}) {
  Probe probe;
  probe.kind = kind;
  probe.target = std::move(target);
  probe.command = std::move(command);
  probe.period_s = 0.02;
  probe.timeout_s = 20;
  probe.failures = 2;
  return probe;
}

TEST(ProbeRunner, HttpIsGoodByItsStatus) {
  std::atomic<int> asked = 0;
  std::atomic<bool> good = false;
  const Answerer server([&] {
    ++asked;
    return good ? "HTTP/1.1 204 No Content\r\n\r\n" : "HTTP/1.1 503 Busy\r\n\r\n";
  });
  const ProbeRunner runner(probe(Probe::Kind::Http, "http://" + server.place() + "/healthz"));
  ASSERT_TRUE(eventually([&] { return runner.fails(); }));
  EXPECT_FALSE(runner.was_good());
  EXPECT_GE(asked, 2);
  good = true;
  EXPECT_TRUE(eventually([&] { return runner.was_good() && !runner.fails(); }));
}

TEST(ProbeRunner, TcpIsGoodWhereSomebodyListens) {
  std::optional<Answerer> server(std::in_place, [] { return ""; });
  const ProbeRunner runner(probe(Probe::Kind::Tcp, server->place()));
  ASSERT_TRUE(eventually([&] { return runner.was_good(); }));
  EXPECT_FALSE(runner.fails());
  server.reset();
  EXPECT_TRUE(eventually([&] { return runner.fails(); }));
}

TEST_F(SupervisorTest, ReadinessHoldsBackWhatComesAfter) {
  const std::string count = folder_ + "/count";
  ProcessPlan first = shell("a", "sleep 1000");
  const std::string third = "echo >> " + count + "; test $(wc -l < " + count + ") -ge 3";
  first.readiness = probe(Probe::Kind::Command, "", {"/bin/sh", "-c", third});
  launch({first, shell("b", "wc -l < " + count + "; sleep 1000", {0})});
  ASSERT_TRUE(wait_for_line("b | "));
  EXPECT_THAT(lines(), testing::Contains(testing::MatchesRegex("b . [3-9].*")));
}

TEST_F(SupervisorTest, WhatIsNeverReadyIsKilled) {
  ProcessPlan never = shell("a", "sleep 1000");
  never.readiness = probe(Probe::Kind::Command, "", {"/bin/false"});
  never.start_timeout_s = 0.2;
  launch({never});
  EXPECT_TRUE(wait_for_line("a * not ready within 0.2 s, killing it"));
}

TEST_F(SupervisorTest, WhoseLivenessFailsIsStartedAgain) {
  const std::string dead = folder_ + "/dead";
  ProcessPlan mortal = shell("a", "rm -f " + dead + "; echo up; sleep 1000");
  mortal.liveness = probe(Probe::Kind::Command, "", {"/bin/sh", "-c", "test ! -e " + dead});
  launch({mortal});
  ASSERT_TRUE(wait_for_line("a | up"));
  std::ofstream{dead};
  EXPECT_TRUE(wait_for_line("a * its liveness probe fails, killing it"));
  EXPECT_TRUE(wait_for_line("a | up", 2));
}

}  // namespace
}  // namespace splatbus::cli
