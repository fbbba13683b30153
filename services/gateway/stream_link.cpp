#include "gateway/stream_link.h"

#include <fmt/format.h>

#include "bus/connection_watch.h"
#include "bus/curve.h"
#include "bus/error.h"
#include "bus/private_folder.h"
#include "stream/packets.h"
#include "stream/relay_client.h"

namespace splatbus::gateway {

namespace {

// Few, since what waits here is memory of a browser that does not read; the streamer holds the rest, once for all.
constexpr int kQueuedFromStreamer = 8;
constexpr int kQueuedToStreamer = 64;
constexpr int kGoodbyeMs = 100;
constexpr int kConnectMs = 1000;
constexpr std::int64_t kMaxFrameBytes = std::int64_t{32} << 20;

}  // namespace

StreamLink::StreamLink(zmq::context_t& context, const std::string& endpoint, std::uint64_t client)
    : socket_(context, zmq::socket_type::dealer), client_(client != 0 ? stream::client_frame(client) : "") {
  socket_.set(zmq::sockopt::rcvhwm, kQueuedFromStreamer);
  socket_.set(zmq::sockopt::sndhwm, kQueuedToStreamer);
  socket_.set(zmq::sockopt::linger, 0);
  // Not ZMQ_IMMEDIATE: a connection that ends between two frames of a message would end the process (libzmq's fq.cpp).
  // Hardly slower with time: a streamer that died is back within half a second, and is to be found at once.
  socket_.set(zmq::sockopt::reconnect_ivl, 50);
  socket_.set(zmq::sockopt::reconnect_ivl_max, 200);
  socket_.set(zmq::sockopt::connect_timeout, kConnectMs);
  bus::watch_connections(socket_);
  socket_.set(zmq::sockopt::maxmsgsize, kMaxFrameBytes);
  if (endpoint.empty()) return;
  bus::require_transport(endpoint);
  bus::require_own_endpoint(endpoint);
  if (const auto keys = bus::client_keys(endpoint, "", "")) bus::use_keys(socket_, *keys);
  try {
    socket_.connect(endpoint);
  } catch (const zmq::error_t& error) {
    throw bus::Error(fmt::format("{}: {}", endpoint, error.what()));
  }
}

bool StreamLink::receive(StreamPacket& packet) {
  while (socket_.recv(packet.packet, zmq::recv_flags::dontwait)) {
    packet.payload.rebuild();
    if (!packet.packet.more()) return true;
    (void)socket_.recv(packet.payload);
    if (!packet.payload.more()) return true;
    zmq::message_t rest;
    do {
      (void)socket_.recv(rest);
    } while (rest.more());
  }
  return false;
}

bool StreamLink::send(const FramedPacket& packet, const bus::Rights& rights) {
  using zmq::send_flags;
  const std::string first = bus::rights_frame(rights);
  // Once the first frame is accepted, the rest of the message is.
  if (socket_.send(zmq::buffer(first), send_flags::dontwait | send_flags::sndmore)) {
    const bool has_payload = !packet.payload.empty();
    if (!client_.empty()) socket_.send(zmq::buffer(client_), send_flags::dontwait | send_flags::sndmore);
    socket_.send(zmq::buffer(packet.packet.data(), packet.packet.size()),
                 has_payload ? send_flags::dontwait | send_flags::sndmore : send_flags::dontwait);
    if (has_payload) {
      socket_.send(zmq::buffer(packet.payload.data(), packet.payload.size()), send_flags::dontwait);
    }
  }
  return (socket_.get(zmq::sockopt::events) & ZMQ_POLLIN) != 0;
}

void StreamLink::say_goodbye() {
  const auto packet = stream::PacketWriter::brief().write(
      0, 0, wire::Body::Bye, [](auto& builder) { return wire::CreateByeDirect(builder, "goes to another streamer"); });
  socket_.set(zmq::sockopt::linger, kGoodbyeMs);
  (void)send({.packet = packet.packet, .payload = {}}, bus::Rights{.view = true});
}

int StreamLink::descriptor() const {
  return socket_.get(zmq::sockopt::fd);
}

}  // namespace splatbus::gateway
