#pragma once

#include <atomic>
#include <cstddef>
#include <memory>
#include <zmq.hpp>

#include "bus/frames.h"

namespace splatbus::bus_service {

/// Bytes that ZeroMQ still has of what one side was sent, whichever of its readers keep it waiting: high-water marks
/// count messages, and one message may have a GiB. Frames below `kCounted` are not worth the counting. Frames may be
/// given back on any thread, and later than this goes.
class UnsentBytes {
 public:
  static constexpr std::size_t kCounted = 4096, kSmall = std::size_t{64} << 10;

  explicit UnsentBytes(std::size_t max_bytes);

  /// Whether there is room for a message of `bytes` beside `more` that are on their way: a first one always has it, and
  /// what is small has a quarter more than the rest, so that pictures and models do not silence heartbeats.
  [[nodiscard]] bool has_room(std::size_t bytes, std::size_t more = 0) const;

  /// Memory for a frame, to be written before it is sent.
  [[nodiscard]] zmq::message_t make(std::size_t bytes) const;
  /// The same bytes as in `frame`: copied, or shared where nobody changes them any more.
  [[nodiscard]] zmq::message_t copy(const zmq::message_t& frame) const;
  [[nodiscard]] zmq::message_t share(const zmq::message_t& frame) const;
  [[nodiscard]] bus::Frames share(const bus::Frames& frames) const;

  [[nodiscard]] std::size_t bytes() const { return *counter_; }

 private:
  const std::size_t max_bytes_;
  const std::shared_ptr<std::atomic<std::size_t>> counter_;
};

}  // namespace splatbus::bus_service
