// The viewer's ZeroMQ link to a streamer, here a bare socket.
#include "viewer/packet_link.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <array>
#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

namespace splatbus::viewer {
namespace {

using namespace std::chrono_literals;

/// A streamer and its one viewer.
struct Served {
  Served(zmq::context_t& context, const std::string& endpoint) : streamer(context, zmq::socket_type::router) {
    streamer.set(zmq::sockopt::linger, 0);
    streamer.set(zmq::sockopt::rcvtimeo, 60'000);
    streamer.bind(endpoint);
    link = make_zmq_link(streamer.get(zmq::sockopt::last_endpoint), "", "");
    greet();
  }
  /// Who the viewer is, by its word.
  void greet() {
    const std::array<std::uint8_t, 2> hello{'h', 'i'};
    link->send(hello);
    zmq::message_t packet;
    ASSERT_TRUE(streamer.recv(viewer));
    ASSERT_TRUE(streamer.recv(packet));
  }
  void send(int number) {
    zmq::message_t to(viewer.data(), viewer.size());
    streamer.send(to, zmq::send_flags::sndmore);
    streamer.send(zmq::buffer(fmt::format("packet {}", number)), zmq::send_flags::sndmore);
    streamer.send(zmq::buffer(std::string(2000, 'x')));
  }
  std::string receive() {
    const auto end = std::chrono::steady_clock::now() + 60s;
    while (std::chrono::steady_clock::now() < end) {
      if (const auto message = link->receive()) return {message->packet.begin(), message->packet.end()};
      link->wait(100ms, -1);
    }
    return "nothing";
  }

  zmq::socket_t streamer;
  std::unique_ptr<PacketLink> link;
  zmq::message_t viewer;
};

// A window that was dragged, a device that was reset, a laptop that slept: libzmq ended the process.
TEST(ZmqLink, GoesOnAfterItWasNotReadForLong) {
  zmq::context_t context;
  std::vector<std::unique_ptr<Served>> all;
  for (const char* endpoint : {"ipc://*", "tcp://127.0.0.1:*"}) {
    all.push_back(std::make_unique<Served>(context, endpoint));
  }
  constexpr int kPackets = 300;  // more than wait in the link, and in its buffer of what has come
  for (const auto& one : all) {
    for (int number = 0; number < kPackets; ++number) one->send(number);
  }
  std::this_thread::sleep_for(8s);  // longer than a connection may be silent
  for (const auto& one : all) {
    for (int number = 0; number < kPackets; ++number) ASSERT_EQ(one->receive(), fmt::format("packet {}", number));
  }
}

}  // namespace
}  // namespace splatbus::viewer
