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

/// What became of one topic's messages.
struct TopicRecord {
  std::uint64_t messages = 0, bytes = 0;  ///< that went to the disk, or wait for it
  std::uint64_t slow_disk = 0;            ///< dropped: the queue was full
  std::uint64_t failed_disk = 0;          ///< dropped: the disk failed, or was full, before they were written
  std::uint64_t overwritten = 0;  ///< dropped: a tensor's slot was written again, or its slab gone, before it was read
  std::uint64_t refused = 0;      ///< dropped: they make no sense
  std::uint64_t lost = 0;         ///< never arrived here, by gaps in their sequence
  [[nodiscard]] std::uint64_t dropped() const { return slow_disk + failed_disk + overwritten + refused + lost; }
  TopicRecord& operator+=(const TopicRecord& other);
};

/// "12 (slow disk 9, overwritten 3)"; empty when nothing is missing.
[[nodiscard]] std::string describe_drops(const TopicRecord& record);

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
    std::map<std::string, TopicRecord> topics;
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
  [[nodiscard]] mcap::StringMap drops() const;

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
  bool finishing_ = false, abandoned_ = false;
  RecordingFile file_;  // the thread's alone, once that runs
  std::jthread thread_;
};

/// CLOCK_REALTIME minus CLOCK_MONOTONIC, nanoseconds.
[[nodiscard]] std::int64_t realtime_minus_monotonic_ns();

}  // namespace splatbus::cli
