#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <stop_token>
#include <string>
#include <thread>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "../streamer/stream_fixture.h"
#include "gateway/foxglove/service.h"
#include "gateway/server.h"
#include "stream/relay_client.h"
#include "wire_client.h"

namespace splatbus::gateway_test {

using Settings = std::vector<std::pair<std::string, std::string>>;

/// A gateway on a thread and a port of its own.
class RunningGateway {
 public:
  RunningGateway(std::shared_ptr<bus::Context> context, const std::string& streamer, const Settings& settings)
      : options_(read(settings)),
        pipeline_(context),
        streamers_(streamer.empty() ? gateway::Streamers(context, "") : gateway::Streamers(streamer)),
        pages_(zmq_, streamer, options_.page_cache_bytes, traffic_),
        models_(context, options_.max_model_gaussians, traffic_, options_.mip),
        site_(options_, pipeline_, pages_, models_, traffic_),
        foxglove_(std::move(context), options_) {
    gateway::check(options_);
    server_ =
        std::make_unique<gateway::Server>(options_, streamers_, site_, pages_, models_, foxglove_.hub(), traffic_);
    thread_ = std::thread([this] { server_->run(stop_.get_token(), [this] { pipeline_.poll(bus::now_ns()); }); });
  }
  ~RunningGateway() {
    stop_.request_stop();
    thread_.join();
  }
  RunningGateway(const RunningGateway&) = delete;
  RunningGateway& operator=(const RunningGateway&) = delete;

  [[nodiscard]] const std::string& url() const { return server_->url(); }
  [[nodiscard]] std::uint16_t port() const {
    return static_cast<std::uint16_t>(std::stoi(url().substr(url().rfind(':') + 1)));
  }

  static gateway::Options read(const Settings& settings) {
    bus::Parameters parameters(bus::Parameters::declare<gateway::Options>());
    EXPECT_EQ(parameters.set("http", "127.0.0.1:0", false), "");
    EXPECT_EQ(parameters.set("web_root", "/nonexistent", false), "");
    for (const auto& [name, value] : settings) EXPECT_EQ(parameters.set(name, value, false), "");
    return parameters.read<gateway::Options>();
  }

 private:
  gateway::Options options_;
  gateway::PipelineView pipeline_;
  gateway::Streamers streamers_;
  gateway::Traffic traffic_;
  zmq::context_t zmq_;
  gateway::PageLibrary pages_;
  gateway::ModelFiles models_;
  gateway::Site site_;
  gateway::foxglove::Service foxglove_;
  std::unique_ptr<gateway::Server> server_;
  std::stop_source stop_;
  std::thread thread_;
};

/// A ROUTER in the streamer's place, which sends and receives what the test says.
class FakeStreamer {
 public:
  explicit FakeStreamer(const std::string& folder)
      : endpoint_("ipc://" + folder + "/fake"), router_(context_, zmq::socket_type::router) {
    router_.set(zmq::sockopt::sndhwm, 64);
    router_.set(zmq::sockopt::linger, 0);
    router_.set(zmq::sockopt::router_mandatory, true);
    router_.bind(endpoint_);
  }
  [[nodiscard]] const std::string& endpoint() const { return endpoint_; }

  struct Received {
    std::string peer;
    std::vector<std::string> frames;  ///< of the packet, without rights and client before it
    std::string rights, client;
  };
  Received receive() { return receive(kPatience); }
  Received receive(std::chrono::milliseconds timeout) {
    router_.set(zmq::sockopt::rcvtimeo, static_cast<int>(timeout.count()));
    Received received;
    zmq::message_t frame;
    if (!router_.recv(frame)) return received;
    received.peer = frame.to_string();
    (void)router_.recv(frame);
    received.rights = frame.to_string();
    while (frame.more()) {
      (void)router_.recv(frame);
      if (received.frames.empty() && stream::parse_client_frame(frame.to_string_view())) {
        received.client = frame.to_string();
        continue;
      }
      received.frames.push_back(frame.to_string());
    }
    return received;
  }
  /// False when the peer's queue is full, or the peer is gone.
  bool send(const std::string& peer, const std::vector<std::string>& frames) {
    try {
      if (!router_.send(zmq::buffer(peer), zmq::send_flags::sndmore | zmq::send_flags::dontwait)) return false;
    } catch (const zmq::error_t&) {
      return false;
    }
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const auto more = i + 1 < frames.size() ? zmq::send_flags::sndmore : zmq::send_flags::none;
      router_.send(zmq::buffer(frames[i]), more | zmq::send_flags::dontwait);
    }
    return true;
  }

 private:
  std::string endpoint_;
  zmq::context_t context_;
  zmq::socket_t router_;
};

/// Broker, fake trainer, and a gateway before a streamer that is real or not.
class GatewayTest : public stream_test::StreamTest {
 protected:
  void start_gateway(const std::string& streamer, const Settings& settings = {}) {
    gateway_.reset();
    gateway_ = std::make_unique<RunningGateway>(connect("gateway"), streamer, settings);
    port_ = gateway_->port();
  }
  FakeStreamer& start_with_fake(const Settings& settings = {}) {
    fake_ = std::make_unique<FakeStreamer>(directory_.path());
    start_gateway(fake_->endpoint(), settings);
    return *fake_;
  }

  [[nodiscard]] nlohmann::json status(const std::string& fields = "") const {
    return nlohmann::json::parse(get(port_, "/status", fields).body, nullptr, false);
  }
  /// How many were turned away for that reason.
  [[nodiscard]] int refused(const std::string& reason) const { return status()["gateway"]["refused"][reason]; }

  /// A file of this test's own.
  std::string write(const std::string& name, const std::string& text) const {
    std::string path = directory_.path() + "/" + name;
    std::filesystem::create_directories(std::filesystem::path(path).parent_path());
    std::ofstream(path) << text;
    return path;
  }

  template <class Build>
  static stream::EncodedPacket packet(wire::Body body, const Build& build, std::uint64_t epoch = 0) {
    return stream::PacketWriter("page", 1).write(epoch, 0, body, build);
  }
  static stream::EncodedPacket hello(const std::string& name = "page", bool probes = false) {
    return packet(wire::Body::Hello,
                  [&](auto& builder) { return wire::CreateHelloDirect(builder, name.c_str(), nullptr, probes, 0); });
  }
  static stream::EncodedPacket pose() {
    return packet(wire::Body::Pose, [](auto& builder) {
      const wire::Camera camera = to_wire(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
      return wire::CreatePose(builder, &camera);
    });
  }

  std::unique_ptr<FakeStreamer> fake_;
  std::unique_ptr<RunningGateway> gateway_;
  std::uint16_t port_ = 0;
};

/// The next message of the subprotocol, without its length: packet and payload behind one another.
inline std::string page_text(WebSocketClient& page) {
  const auto message = page.receive();
  return message && message->size() >= 4 ? message->substr(4) : "";
}

inline std::string text_of(const stream::Bytes& bytes) {
  return {bytes.begin(), bytes.end()};
}

}  // namespace splatbus::gateway_test
