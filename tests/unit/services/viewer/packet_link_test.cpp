// The viewer's ZeroMQ link to a streamer, here a bare socket.
#include "viewer/packet_link.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <memory>
#include <string>
#include <thread>
#include <vector>
#include <zmq.hpp>

#include "../../bus/bus_fixture.h"
#include "bus/connection_watch.h"

namespace splatbus::viewer {
namespace {

using namespace std::chrono_literals;

/// A streamer and its one viewer.
struct Served {
  Served(zmq::context_t& context, const std::string& endpoint) : streamer(context, zmq::socket_type::router) {
    streamer.set(zmq::sockopt::linger, 0);
    bus::watch_connections(streamer);
    streamer.set(zmq::sockopt::rcvtimeo, 1000);
    streamer.bind(endpoint);
    link = make_zmq_link(streamer.get(zmq::sockopt::last_endpoint), "", "");
  }
  /// Learns who the viewer is, by its word.
  bool greet() {
    const std::array<std::uint8_t, 2> hello{'h', 'i'};
    link->send(hello);
    zmq::message_t packet;
    return streamer.recv(viewer) && streamer.recv(packet);
  }
  void send(const std::string& packet) {
    streamer.send(zmq::message_t(viewer.data(), viewer.size()), zmq::send_flags::sndmore);
    streamer.send(zmq::buffer(packet), zmq::send_flags::sndmore);
    streamer.send(zmq::buffer(std::string(2000, 'x')), zmq::send_flags::none);
  }
  bool receives(const std::string& packet) {
    while (const auto message = link->receive()) {
      if (std::ranges::equal(message->packet, packet)) return true;
    }
    return false;
  }

  zmq::socket_t streamer;
  std::unique_ptr<PacketLink> link;
  zmq::message_t viewer;
};

// A window that was dragged, a device that was reset, a laptop that slept: libzmq ended the process.
TEST(ZmqLink, GoesOnAfterItWasNotReadForLong) {
  const bus_test::TemporaryDirectory directory;
  zmq::context_t context;
  std::vector<std::unique_ptr<Served>> all;
  for (const std::string& endpoint : {"ipc://" + directory.path() + "/streamer", std::string("tcp://127.0.0.1:*")}) {
    all.push_back(std::make_unique<Served>(context, endpoint));
    ASSERT_TRUE(bus_test::eventually([&] { return all.back()->greet(); }));
    // More than wait in the link, and in its buffer of what has come.
    for (int number = 0; number < 300; ++number) all.back()->send("early");
  }
  std::this_thread::sleep_for(8s);  // longer than a connection may be silent
  for (const auto& one : all) {
    EXPECT_TRUE(bus_test::eventually([&] {
      if (one->greet()) one->send("late");
      return one->receives("late");
    }));
  }
}

}  // namespace
}  // namespace splatbus::viewer
