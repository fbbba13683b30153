#include "bench/bus_ways.h"

#include <unistd.h>

#include <cstring>
#include <memory>
#include <thread>
#include <zmq.hpp>

#include "bus/broker.h"
#include "bus/publisher.h"
#include "bus/subscriber.h"
#include "wire/system_generated.h"

namespace splatbus::bench {

namespace {

constexpr Topic<wire::Log> kSmall{"bench/small"};
constexpr std::size_t kSmallBytes = 192;  // of a body, as the bus's of this message

std::string endpoint(const std::string& folder, const char* name) {
  return "ipc://" + folder + "/" + name;
}

void zmq_relay(const std::string& folder) {
  zmq::context_t context;
  zmq::socket_t in(context, zmq::socket_type::xsub), out(context, zmq::socket_type::xpub);
  for (zmq::socket_t* socket : {&in, &out}) {
    socket->set(zmq::sockopt::sndhwm, 4096);
    socket->set(zmq::sockopt::rcvhwm, 4096);
  }
  in.bind(endpoint(folder, "in"));
  out.bind(endpoint(folder, "out"));
  zmq::proxy(zmq::socket_ref(in), zmq::socket_ref(out));
}

std::function<void()> bus_sender(const std::string& folder) {
  const auto context = bus::Context::create(bus::Address::parse("ipc://" + folder), "sender");
  if (!context->wait_connected(std::chrono::seconds(20))) throw std::runtime_error("no broker");
  return [publisher = bus::Publisher(context)] {
    publisher.publish(kSmall, [](auto& builder, auto header) {
      return wire::CreateLogDirect(builder, header, wire::LogLevel::Info, "sixteen letters.");
    });
  };
}

void bus_read(const std::string& folder, Shared& shared) {
  bus::Subscriber subscriber(bus::Context::create(bus::Address::parse("ipc://" + folder), "reader"));
  subscriber.on(kSmall,
                [&](const wire::Log&, const bus::Message& message) { shared.take(message.header().publish_ns()); });
  if (!subscriber.wait_connected(std::chrono::seconds(20))) throw std::runtime_error("no broker");
  shared.reads = true;
  while (!shared.stop) subscriber.dispatch_all(kPatience);
}

}  // namespace

std::function<void()> zmq_sender(const std::string& folder, bool through_proxy, std::size_t bytes) {
  auto context = std::make_shared<zmq::context_t>();
  auto socket = std::make_shared<zmq::socket_t>(*context, zmq::socket_type::xpub);
  socket->set(zmq::sockopt::sndhwm, 4096);
  if (through_proxy) {
    socket->connect(endpoint(folder, "in"));
  } else {
    socket->bind(endpoint(folder, "out"));
  }
  zmq::message_t subscription;
  (void)socket->recv(subscription);
  auto memory = std::make_shared<std::vector<std::byte>>(bytes);
  return [context, socket, memory] {
    const std::int64_t now = bus::now_ns();
    std::memcpy(memory->data(), &now, sizeof now);
    (void)socket->send(zmq::buffer(kSmall.name), zmq::send_flags::sndmore);
    (void)socket->send(zmq::buffer(*memory), zmq::send_flags::none);
  };
}

void zmq_read(const std::string& folder, Shared& shared) {
  zmq::context_t context;
  zmq::socket_t socket(context, zmq::socket_type::sub);
  socket.set(zmq::sockopt::rcvhwm, 4096);
  socket.set(zmq::sockopt::subscribe, kSmall.name);
  socket.connect(endpoint(folder, "out"));
  shared.reads = true;
  zmq::message_t topic, body;
  while (!shared.stop) {
    (void)socket.recv(topic);
    (void)socket.recv(body);
    std::int64_t sent_ns = 0;
    std::memcpy(&sent_ns, body.data(), sizeof sent_ns);
    shared.take(sent_ns);
  }
}

void bus_relay(const std::string& folder) {
  bus_service::Broker broker({.address = bus::Address::parse("ipc://" + folder)});
  broker.start();
  while (true) ::pause();
}

std::vector<Way> ways() {
  const auto raw = [](const std::string& folder) { return zmq_sender(folder, false, kSmallBytes); };
  const auto proxied = [](const std::string& folder) { return zmq_sender(folder, true, kSmallBytes); };
  return {{"ZeroMQ, direct", raw, zmq_read, {}},
          {"ZeroMQ, proxy", proxied, zmq_read, zmq_relay},
          {kOurs, bus_sender, bus_read, bus_relay}};
}

void wait_for(const std::function<bool()>& condition) {
  const std::int64_t end = bus::now_ns() + 120'000'000'000;
  while (!condition()) {
    if (bus::now_ns() > end) throw std::runtime_error("a process of the measurement says nothing");
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

}  // namespace splatbus::bench
