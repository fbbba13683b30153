#include "recorder.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "topic_filter.h"

namespace splatbus::cli {

namespace {

constexpr std::chrono::milliseconds kChunkPeriod(1000);  // what a crash may take away
constexpr std::size_t kMaxTracked = 65536;
constexpr std::size_t kMessageBytes = 512;  // of a queued message besides its data

}  // namespace

std::int64_t realtime_minus_monotonic_ns() {
  timespec now{};
  ::clock_gettime(CLOCK_REALTIME, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec - bus::now_ns();
}

TopicRecord Recorder::State::total() const {
  TopicRecord total;
  for (const auto& [topic, record] : topics) total += record;
  return total;
}

Recorder::Recorder(std::shared_ptr<bus::Context> context, RecorderOptions options)
    : options_(std::move(options)),
      subscriber_(std::move(context), options_.topics),
      realtime_minus_monotonic_ns_(cli::realtime_minus_monotonic_ns()),
      file_(options_.file),
      thread_([this] { write_queue(); }) {}

Recorder::~Recorder() {
  const std::scoped_lock lock(mutex_);
  abandoned_ = true;
  changed_.notify_all();
}

bool Recorder::poll(std::chrono::milliseconds timeout) {
  for (auto message = subscriber_.receive(timeout); message;
       message = subscriber_.receive(std::chrono::milliseconds(0))) {
    if (!matches_any(options_.exclude, message->topic())) take(*message);
    const std::scoped_lock lock(mutex_);
    if (state_.full || !state_.failure.empty()) return false;
  }
  const std::scoped_lock lock(mutex_);
  return !state_.full && state_.failure.empty();
}

bool Recorder::has_room(std::size_t bytes, bool latched) const {
  const std::size_t limit = latched ? options_.queue_bytes : options_.queue_bytes - options_.queue_bytes / 8;
  return bytes <= limit && state_.queued_bytes <= limit - bytes;
}

void Recorder::take(const bus::Message& message) {
  const wire::Header& header = message.header();
  const bool with_slabs =
      matches_any(options_.payloads, message.topic()) && !matches_any(options_.without_payloads, message.topic());
  TopicRecord record;
  count_gap(message, record);
  QueuedMessage queued{.topic = message.topic(),
                       .schema = header.schema()->str(),
                       .latched = header.latch(),
                       .latch_key = header.latch_key() == nullptr ? "" : header.latch_key()->str(),
                       .sequence = static_cast<std::uint32_t>(header.sequence()),
                       .log_time = static_cast<std::uint64_t>(bus::now_ns() + realtime_minus_monotonic_ns_),
                       .publish_time = static_cast<std::uint64_t>(header.publish_ns() + realtime_minus_monotonic_ns_),
                       .missing = {},
                       .data = nullptr};
  try {
    const std::size_t bytes = recorded_size(message, with_slabs) + kMessageBytes;
    const bool room = [&] {
      const std::scoped_lock lock(mutex_);
      return has_room(bytes, queued.latched);
    }();
    if (!room) {
      ++record.slow_disk;
    } else if (auto data = to_recorded(message, with_slabs)) {
      queued.data = std::make_shared<const Blob>(std::move(*data));
      ++record.messages;
      record.bytes += queued.data->size;
    } else {
      ++record.overwritten;
    }
  } catch (const bus::Error& error) {
    ++record.refused;
    if (refusals_said_.allow()) spdlog::warn("not recorded: {}", error.what());
  }
  const std::scoped_lock lock(mutex_);
  if (queued.data != nullptr && !state_.failure.empty()) {
    record = {.failed_disk = 1, .lost = record.lost};
    queued.data.reset();
  }
  state_.topics[message.topic()] += record;
  if (record.dropped() > 0) {
    record.messages = record.bytes = 0;
    missing_[message.topic()] += record;
  }
  if (queued.data == nullptr) return;
  queued.missing = std::exchange(missing_, {});
  state_.queued_bytes += queued.data->size + kMessageBytes;
  state_.most_queued_bytes = std::max(state_.most_queued_bytes, state_.queued_bytes);
  queue_.push_back(std::move(queued));
  changed_.notify_all();
}

void Recorder::count_gap(const bus::Message& message, TopicRecord& record) {
  const wire::Header& header = message.header();
  if (positions_.size() >= kMaxTracked) positions_.clear();
  Position& position = positions_[{header.source()->str(), message.topic()}];
  if (position.epoch != header.epoch()) position = {.epoch = header.epoch()};
  const bool live = !header.resent();
  if (live && position.live && header.sequence() > position.sequence + 1) {
    record.lost += header.sequence() - position.sequence - 1;
  }
  position.sequence = std::max(position.sequence, header.sequence());
  position.live = position.live || live;
}

void Recorder::write_queue() try {
  auto chunk_end = std::chrono::steady_clock::now() + kChunkPeriod;
  bool whole = false;
  while (true) {
    QueuedMessage message;
    {
      std::unique_lock lock(mutex_);
      changed_.wait_until(lock, chunk_end, [this] { return !queue_.empty() || finishing_ || abandoned_; });
      whole = finishing_ && queue_.empty();
      if (abandoned_ || whole) break;
      if (!queue_.empty()) {
        message = std::move(queue_.front());
        queue_.pop_front();
      }
    }
    const std::size_t bytes = message.data ? message.data->size + kMessageBytes : 0;
    if (message.data && file_.full()) {
      discard(message);
    } else if (message.data) {
      file_.write(message);
    }
    message.data.reset();
    if (std::chrono::steady_clock::now() >= chunk_end) {
      file_.close_chunk();
      chunk_end = std::chrono::steady_clock::now() + kChunkPeriod;
    }
    const std::scoped_lock lock(mutex_);
    state_.queued_bytes -= bytes;
    state_.file_bytes = file_.bytes();
    state_.parts = file_.parts();
    state_.full = file_.full();
  }
  if (whole) file_.close(take_missing());
  const std::scoped_lock lock(mutex_);
  state_.file_bytes = file_.bytes();
} catch (const std::exception& error) {
  fail(error.what());
}

void Recorder::discard(const QueuedMessage& message) {
  const std::scoped_lock lock(mutex_);
  TopicRecord& record = state_.topics[message.topic];
  record.messages -= 1;
  record.bytes -= message.data->size;
  record.beyond_limit += 1;
  for (const auto& [topic, missing] : message.missing) missing_[topic] += missing;
  missing_[message.topic].beyond_limit += 1;
}

TopicRecords Recorder::take_missing() {
  const std::scoped_lock lock(mutex_);
  return std::exchange(missing_, {});
}

void Recorder::fail(const std::string& why) {
  const std::scoped_lock lock(mutex_);
  const auto lose = [&](const std::string& topic, std::uint64_t messages, std::uint64_t bytes) {
    TopicRecord& record = state_.topics[topic];
    record.messages -= messages;
    record.bytes -= bytes;
    record.failed_disk += messages;
  };
  for (const auto& [topic, count] : file_.unwritten()) lose(topic, count.messages, count.bytes);
  for (const QueuedMessage& message : queue_) lose(message.topic, 1, message.data->size);
  queue_.clear();
  state_.queued_bytes = 0;
  state_.file_bytes = file_.bytes();
  state_.failure = why;
}

void Recorder::finish() {
  {
    const std::scoped_lock lock(mutex_);
    finishing_ = true;
    changed_.notify_all();
  }
  if (thread_.joinable()) thread_.join();
  if (!state_.failure.empty()) throw mcap::Error(state_.failure);
}

Recorder::State Recorder::state() const {
  const std::scoped_lock lock(mutex_);
  return state_;
}

}  // namespace splatbus::cli
