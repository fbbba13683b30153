#pragma once

#include <cstddef>
#include <string>
#include <string_view>
#include <zmq.hpp>

#include "wire/common_generated.h"

namespace splatbus::bus {

constexpr std::size_t max_topic_bytes = 128;
constexpr std::size_t max_body_bytes = std::size_t{64} << 20;
constexpr std::int64_t max_frame_bytes = std::int64_t{1} << 30;  ///< ZMQ_MAXMSGSIZE of every socket

/// A message as it rides on ZeroMQ: topic, FlatBuffer, and a payload when a tensor is inline.
struct Frames {
  zmq::message_t topic;
  zmq::message_t body;
  zmq::message_t payload;
  bool has_payload = false;

  /// Shares the bytes, which nobody may change from then on.
  [[nodiscard]] Frames share() const;
  [[nodiscard]] std::size_t bytes() const { return topic.size() + body.size() + payload.size(); }
  [[nodiscard]] std::string_view topic_text() const { return topic.to_string_view(); }
};

enum class RecvResult { Nothing, Complete, Malformed };

/// Takes the next message, if there is one, without waiting. Body and payload of a complete one are aligned to 8 bytes.
/// Malformed: fewer than two or more than three frames, or one too large; `why` says so, and the message is gone.
RecvResult receive_frames(zmq::socket_ref socket, Frames& frames, std::string& why);

/// Never waits: a message that the socket has no room for is dropped by ZeroMQ.
void send_frames(zmq::socket_ref socket, Frames frames);

/// The Header of a body that verifies as an Envelope and keeps to the limits (names up to 256 bytes, 512 tensors), else
/// null with `why` filled in. Points into the body.
const wire::Header* verified_header(const zmq::message_t& body, std::string& why);

/// A text from a peer, shortened and with control characters replaced, fit for a log line.
std::string printable(std::string_view text, std::size_t limit = 64);

/// What every socket of the bus is set to: high-water marks, how long the last messages linger, the size limit of a
/// frame, reconnection, and watch_connections() where they may leave the machine.
void configure_socket(zmq::socket_t& socket, bool local);

}  // namespace splatbus::bus
