#include <spdlog/spdlog.h>

#include <utility>

#include "bus/relay.h"
#include "bus/relay_messages.h"

// What is sent while there is room for it, and who has to make some.
namespace splatbus::bus_service {
namespace {

constexpr std::size_t max_missed = 8192;  // as many as are held

}  // namespace

void Relay::send(Side& side, const bus::Frames& frames, const wire::Header& header) {
  if (send_now(side, frames, header)) return;
  ++left_out_;
  // What is held is said once: who missed it would wait for the next one, which may never come.
  if (header.latch() && side.missed.size() < max_missed) {
    side.missed.emplace(frames.topic.to_string(), latch_key_of(header));
  }
}

bool Relay::send_now(Side& side, const bus::Frames& frames, const wire::Header& header) {
  if (!side.local) {
    if (!subscriptions_.wants(frames.topic_text())) return true;
    auto offered = remote_readers_.offer(frames, header);
    if (offered.now) send_on(side, std::move(*offered.now));
    return !offered.left_out;
  }
  // What comes over tcp has its bulk data in it, and a reader that is stopped lets thousands of messages wait.
  if (!unsent_here_.has_room(frames.bytes())) {
    full_here_lately_ = true;
    return false;
  }
  send_on(side, unsent_here_.share(frames));
  return true;
}

void Relay::send_on(Side& side, bus::Frames frames) {
  bus::send_frames(side.xpub, std::move(frames));
  waits_.used(side.xpub_wait);
}

void Relay::resend_missed(Side& side) {
  std::erase_if(side.missed, [&](const auto& missed) {
    const auto* held = held_.find(missed.first, missed.second);
    return held == nullptr || send_now(side, held->frames, header_of(held->frames));
  });
}

void Relay::make_room(std::int64_t now) {
  for (const auto& topic : remote_readers_.take_unserved()) {
    if (readers_guard_) readers_guard_->make_room(subscriptions_.readers_of(topic));
  }
  local_readers_.look(now);
  if (!std::exchange(full_here_lately_, false)) return;
  const auto stuck = local_readers_.close_stuck(now);
  if (!stuck.empty() && limiter_.allow()) {
    spdlog::warn("closed the connections of {} readers, which took nothing while others waited; process {} was one",
                 stuck.size(), stuck.front());
  }
}

}  // namespace splatbus::bus_service
