#include "bus/counted_frames.h"

#include <cstring>
#include <utility>

namespace splatbus::bus_service {
namespace {

using Counter = std::shared_ptr<std::atomic<std::size_t>>;

/// What a frame's bytes lie in, and the count of them.
template <class Memory>
struct Counted {
  Counted(Counter bytes_of, std::size_t size, Memory of)
      : counter(std::move(bytes_of)), bytes(size), memory(std::move(of)) {
    *counter += bytes;
  }
  ~Counted() { *counter -= bytes; }

  /// ZeroMQ carries it from thread to thread by ways that ThreadSanitizer does not see: this one it does.
  void hand_over() { is_handed_over.store(true, std::memory_order_release); }
  void take_over() const { static_cast<void>(is_handed_over.load(std::memory_order_acquire)); }

  Counted(const Counted&) = delete;
  Counted& operator=(const Counted&) = delete;

  Counter counter;
  std::size_t bytes;
  Memory memory;
  std::atomic<bool> is_handed_over = false;
};

template <class Memory>
zmq::message_t counted_frame(void* data, std::unique_ptr<Counted<Memory>> counted) {
  const std::size_t bytes = counted->bytes;
  const auto release = [](void*, void* hint) {
    const std::unique_ptr<Counted<Memory>> owned(static_cast<Counted<Memory>*>(hint));
    owned->take_over();
  };
  counted->hand_over();
  return zmq::message_t(data, bytes, release, counted.release());
}

zmq::message_t shared(const zmq::message_t& frame) {
  zmq::message_t copy;
  // ZeroMQ counts the reference inside of the frame; its bytes stay as they are.
  copy.copy(const_cast<zmq::message_t&>(frame));
  return copy;
}

}  // namespace

UnsentBytes::UnsentBytes(std::size_t max_bytes)
    : max_bytes_(max_bytes), counter_(std::make_shared<std::atomic<std::size_t>>(0)) {}

bool UnsentBytes::has_room(std::size_t bytes, std::size_t more) const {
  const std::size_t taken = *counter_ + more;
  if (taken == 0 || bytes < kCounted) return true;
  return taken + bytes <= max_bytes_ + (bytes <= kSmall ? max_bytes_ / 4 : 0);
}

zmq::message_t UnsentBytes::make(std::size_t bytes) const {
  if (bytes < kCounted) return zmq::message_t(bytes);
  using Memory = std::unique_ptr<std::byte[]>;
  auto counted = std::make_unique<Counted<Memory>>(counter_, bytes, std::make_unique_for_overwrite<std::byte[]>(bytes));
  std::byte* const data = counted->memory.get();
  return counted_frame(data, std::move(counted));
}

zmq::message_t UnsentBytes::copy(const zmq::message_t& frame) const {
  zmq::message_t result = make(frame.size());
  if (!frame.empty()) std::memcpy(result.data(), frame.data(), frame.size());
  return result;
}

zmq::message_t UnsentBytes::share(const zmq::message_t& frame) const {
  if (frame.size() < kCounted) return shared(frame);
  auto counted = std::make_unique<Counted<zmq::message_t>>(counter_, frame.size(), shared(frame));
  void* const data = counted->memory.data();
  return counted_frame(data, std::move(counted));
}

bus::Frames UnsentBytes::share(const bus::Frames& frames) const {
  return {shared(frames.topic), share(frames.body), share(frames.payload), frames.has_payload};
}

}  // namespace splatbus::bus_service
