#include "sdk/frame_sender.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <optional>
#include <span>
#include <utility>

#include "bus/error.h"
#include "sdk/messages.h"

namespace splatbus::engine_sdk {
namespace {

using namespace std::chrono_literals;

constexpr auto kAttempt = 100ms;  // how soon the end is seen
constexpr auto kLinger = 500ms;

}  // namespace

FrameSender::Waiting::Waiting(const splatbus_frame& of, WrittenFrame written, std::int64_t when)
    : ring(std::move(written.ring)),
      objects(of.objects, of.objects + of.object_count),
      sources(of.light.sources, of.light.sources + of.light.source_count),
      frame(of),
      info{.capture_ns = when, .tensors = std::move(written.tensors)} {
  frame.images = nullptr;  // in the ring by now
  frame.image_count = 0;
  frame.objects = objects.data();
  frame.light.sources = sources.data();
}

FrameSender::FrameSender(std::shared_ptr<bus::Context> context)
    : context_(std::move(context)), publisher_(context_), thread_([this](const std::stop_token& stop) { run(stop); }) {}

FrameSender::~FrameSender() = default;

void FrameSender::send(const splatbus_frame& frame, WrittenFrame written, std::int64_t capture_ns) {
  const std::scoped_lock lock(mutex_);
  if (waiting_.empty() && (!written.ring || written.ring->registered)) {
    publish(frame, {.capture_ns = capture_ns, .tensors = std::move(written.tensors)});
    return;
  }
  const std::shared_ptr<FrameRing> ring = written.ring;
  if (!ring) std::erase_if(waiting_, [](const Waiting& entry) { return !entry.ring; });
  waiting_.emplace_back(frame, std::move(written), capture_ns);
  if (ring) drop_oldest_beyond_half(*ring);
  more_.notify_one();
}

void FrameSender::drop_oldest_beyond_half(const FrameRing& ring) {
  const auto in_ring = [&](const Waiting& entry) { return entry.ring.get() == &ring; };
  if (static_cast<std::size_t>(std::ranges::count_if(waiting_, in_ring)) <= ring.slab->slots() / 2) return;
  waiting_.erase(std::ranges::find_if(waiting_, in_ring));
  ++dropped_;
}

void FrameSender::give_back(std::shared_ptr<FrameRing> ring) {
  const std::scoped_lock lock(mutex_);
  given_back_.push_back(std::move(ring));
  more_.notify_one();
}

std::string FrameSender::refusal(const FrameRing& ring) const {
  const std::scoped_lock lock(mutex_);
  return ring.refusal;
}

std::uint64_t FrameSender::dropped() const {
  const std::scoped_lock lock(mutex_);
  return dropped_;
}

void FrameSender::publish(const splatbus_frame& frame, const bus::MessageInfo& info) const {
  publisher_.publish(topics::kEngineFrame, info,
                     [&](auto& builder, auto header) { return build_frame(builder, header, frame); });
}

void FrameSender::publish_waiting() {
  try {
    while (!waiting_.empty() && waiting_.front().ready()) {
      publish(waiting_.front().frame, waiting_.front().info);
      waiting_.pop_front();
    }
  } catch (const std::exception& error) {
    spdlog::error("a frame could not be sent: {}", error.what());
    waiting_.pop_front();
    ++dropped_;
  }
}

void FrameSender::run(const std::stop_token& stop) {
  std::optional<std::chrono::steady_clock::time_point> end;
  std::unique_lock lock(mutex_);
  while (more_.wait(lock, stop, [this] { return !waiting_.empty() || !given_back_.empty(); })) {
    if (stop.stop_requested()) {
      const auto now = std::chrono::steady_clock::now();
      if (!end) end = now + kLinger;
      if (now > *end) return;
    }
    // First of all: another ring may have that role by now, and is registered after this.
    if (auto rings = std::exchange(given_back_, {}); !rings.empty()) {
      lock.unlock();
      for (const auto& ring : rings) context_->drop_slab(ring->role);
      rings.clear();
      lock.lock();
      continue;
    }
    const std::shared_ptr<FrameRing> ring = waiting_.front().ring;
    if (!ring) {
      publish_waiting();
      continue;
    }
    bool registered = false;
    std::string refusal;
    lock.unlock();
    try {
      registered = context_->register_slab(ring->slab, kAttempt);
    } catch (const bus::Error& error) {
      refusal = error.what();
      spdlog::error("{}", refusal);
    }
    lock.lock();
    ring->registered = registered;
    ring->refusal = refusal;
    if (!refusal.empty()) dropped_ += std::erase_if(waiting_, [&](const Waiting& entry) { return entry.ring == ring; });
    publish_waiting();
  }
}

}  // namespace splatbus::engine_sdk
