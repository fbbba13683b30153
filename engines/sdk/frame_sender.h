#pragma once

#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "sdk/frame_rings.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::engine_sdk {

/// Publishes frames in the order in which they come, each once readers can open the ring that it lies in. A thread of
/// its own registers the rings, so that nobody who sends waits for the broker. Until then the newest frames wait, half
/// a ring of them at most, so that readers have time for the others. send() is for one thread.
class FrameSender {
 public:
  explicit FrameSender(std::shared_ptr<bus::Context> context);
  /// Waits for what is still to be sent, for half a second at most.
  ~FrameSender();

  /// One without a ring waits for those before it, and then the newest of its kind is enough.
  void send(const splatbus_frame& frame, WrittenFrame written, std::int64_t capture_ns);

  /// The bus forgets a ring that nothing will be sent of any more, and its memory goes, which takes its time.
  void give_back(std::shared_ptr<FrameRing> ring);

  /// Why the bus will not have this ring, or an empty string.
  [[nodiscard]] std::string refusal(const FrameRing& ring) const;
  /// Frames that were never sent.
  [[nodiscard]] std::uint64_t dropped() const;

 private:
  /// With objects and lights of its own.
  struct Waiting {
    Waiting(const splatbus_frame& of, WrittenFrame written, std::int64_t when);
    [[nodiscard]] bool ready() const { return !ring || ring->registered; }
    std::shared_ptr<FrameRing> ring;  ///< null: it has no images
    std::vector<splatbus_object> objects;
    std::vector<splatbus_light_source> sources;
    splatbus_frame frame;
    bus::MessageInfo info;
  };

  void run(const std::stop_token& stop);
  void publish(const splatbus_frame& frame, const bus::MessageInfo& info) const;
  void publish_waiting();
  void drop_oldest_beyond_half(const FrameRing& ring);

  std::shared_ptr<bus::Context> context_;
  bus::Publisher publisher_;
  mutable std::mutex mutex_;
  std::condition_variable_any more_;
  std::deque<Waiting> waiting_;
  std::vector<std::shared_ptr<FrameRing>> given_back_;
  std::uint64_t dropped_ = 0;
  std::jthread thread_;
};

}  // namespace splatbus::engine_sdk
