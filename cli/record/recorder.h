#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bus/log_sink.h"
#include "bus/subscriber.h"
#include "recording_file.h"
#include "topic_record.h"

namespace splatbus::cli {

struct RecorderOptions {
  std::vector<std::string> topics{"*"};  ///< names; one that ends in * is a prefix
  std::vector<std::string> exclude;
  /// Topics whose tensors in slabs are recorded, but not those of `without_payloads`.
  std::vector<std::string> payloads{"*"};
  std::vector<std::string> without_payloads{"model/published"};  ///< the live model: its values change in place
  std::size_t queue_bytes = std::size_t{256} << 20;              ///< between the bus and the disk
  RecordingFileOptions file;
};

/// Records a bus: the caller's thread receives, and copies tensors out of their slabs at once; another one compresses
/// and writes. Between them lie `queue_bytes` at most, and what finds no room is dropped and counted; the last eighth
/// is for latched messages.
class Recorder {
 public:
  /// Throws mcap::Error when the file cannot be made.
  Recorder(std::shared_ptr<bus::Context> context, RecorderOptions options);
  ~Recorder();  ///< without finish(): as after a crash
  Recorder(const Recorder&) = delete;
  Recorder& operator=(const Recorder&) = delete;

  /// Waits for the bus; false when there is none within `timeout`.
  [[nodiscard]] bool wait_connected(std::chrono::milliseconds timeout) { return subscriber_.wait_connected(timeout); }

  /// Takes in what has arrived; waits for it up to `timeout`. False once no more is taken: the file is full, or the
  /// disk has failed.
  bool poll(std::chrono::milliseconds timeout);

  /// Waits for the disk and completes the file. Throws mcap::Error when the disk has failed: what state() counts as
  /// messages can be read nevertheless.
  void finish();

  struct State {
    TopicRecords topics;
    std::size_t queued_bytes = 0, most_queued_bytes = 0;
    std::uint64_t file_bytes = 0;
    unsigned parts = 1;
    bool full = false;
    std::string failure;  ///< of the disk

    [[nodiscard]] TopicRecord total() const;
  };
  [[nodiscard]] State state() const;

 private:
  void take(const bus::Message& message);
  void count_gap(const bus::Message& message, TopicRecord& record);
  [[nodiscard]] bool has_room(std::size_t bytes, bool latched) const;
  void write_queue();
  void fail(const std::string& why);
  [[nodiscard]] TopicRecords take_missing();
  void discard(const QueuedMessage& message);

  const RecorderOptions options_;
  bus::Subscriber subscriber_;
  const std::int64_t realtime_minus_monotonic_ns_;
  struct Position {
    std::uint64_t epoch = 0, sequence = 0;
    bool live = false;
  };
  std::map<std::pair<std::string, std::string>, Position> positions_;  // by source and topic
  bus::LogLimiter refusals_said_;

  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<QueuedMessage> queue_;
  State state_;
  TopicRecords missing_;  ///< since the newest message in the queue
  bool finishing_ = false, abandoned_ = false;
  RecordingFile file_;  // the thread's alone, once that runs
  std::jthread thread_;
};

/// CLOCK_REALTIME minus CLOCK_MONOTONIC, nanoseconds.
[[nodiscard]] std::int64_t realtime_minus_monotonic_ns();

}  // namespace splatbus::cli
