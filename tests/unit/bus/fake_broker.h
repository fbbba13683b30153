#pragma once

#include <gtest/gtest.h>

#include <string>
#include <vector>
#include <zmq.hpp>

#include "bus/context.h"
#include "wire/viewer_generated.h"

namespace splatbus::bus_test {

inline void send_frames(zmq::socket_t& socket, const std::vector<std::string>& frames) {
  for (std::size_t i = 0; i < frames.size(); ++i) {
    socket.send(zmq::buffer(frames[i]), i + 1 < frames.size() ? zmq::send_flags::sndmore : zmq::send_flags::none);
  }
}

/// The XPUB side of a broker that sends whatever a test wants, to see what a Subscriber makes of it.
class FakeBroker {
 public:
  explicit FakeBroker(const bus::Address& address) : socket_(context_, zmq::socket_type::xpub) {
    socket_.bind(address.subscribe_endpoint());
    socket_.set(zmq::sockopt::rcvtimeo, 10000);
  }

  void await_subscription() {
    zmq::message_t event;
    ASSERT_TRUE(socket_.recv(event).has_value());
  }

  void send(const std::vector<std::string>& frames) { send_frames(socket_, frames); }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
};

/// The side of a broker that publishers connect to: takes all that they send.
class FakeReader {
 public:
  explicit FakeReader(const bus::Address& address) : socket_(context_, zmq::socket_type::sub) {
    socket_.set(zmq::sockopt::rcvtimeo, 10000);
    socket_.set(zmq::sockopt::subscribe, "");
    socket_.bind(address.publish_endpoint());
  }

  /// The frames of the next message; none when nothing comes.
  std::vector<std::string> receive() {
    std::vector<std::string> frames;
    zmq::message_t frame;
    do {
      if (!socket_.recv(frame).has_value()) return {};
      frames.push_back(frame.to_string());
    } while (frame.more());
    return frames;
  }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
};

/// A publisher at a broker that sends whatever a test wants: zmq frames, as they are.
class RawPublisher {
 public:
  /// Has been subscribed to when it returns.
  explicit RawPublisher(const std::string& endpoint) : socket_(context_, zmq::socket_type::xpub) {
    socket_.set(zmq::sockopt::rcvtimeo, 10000);
    socket_.set(zmq::sockopt::linger, 1000);
    socket_.connect(endpoint);
    zmq::message_t subscription;
    EXPECT_TRUE(socket_.recv(subscription).has_value());
  }

  void send(const std::vector<std::string>& frames) { send_frames(socket_, frames); }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
};

struct RawTensor {
  std::string name = "values";
  wire::Span span;
  std::vector<std::uint32_t> shape;
  wire::ElementType type = wire::ElementType::F32;
};

/// The body of a ViewerProbe, with a header as the test wants it.
inline std::string probe_body(std::uint64_t sequence, std::uint64_t number, const std::vector<RawTensor>& tensors = {},
                              const std::string& schema = "ViewerProbe/1", bool latch = false,
                              const std::string& latch_key = "") {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<wire::Tensor>> offsets;
  for (const auto& tensor : tensors) {
    offsets.push_back(wire::CreateTensorDirect(builder, tensor.name.c_str(), &tensor.span, &tensor.shape, tensor.type));
  }
  const auto header = wire::CreateHeaderDirect(builder, schema.c_str(), "maker", sequence, 1, 0, 0, 0, latch,
                                               latch_key.c_str(), &offsets);
  const wire::Camera camera;
  builder.Finish(wire::CreateViewerProbe(builder, header, number, &camera));
  return {reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()};
}

}  // namespace splatbus::bus_test
