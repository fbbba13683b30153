#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "mcap/writer.h"
#include "recorded_message.h"
#include "topic_record.h"

namespace splatbus::cli {

/// Names of the metadata in a recording.
inline constexpr const char* kRecordingMetadata = "splatbus.recording";  ///< at the start: version, clock, bus
inline constexpr const char* kLaunchMetadata = "splatbus.launch";        ///< at the start: path and text
inline constexpr const char* kDropsMetadata = "splatbus.drops";          ///< at the end: by topic
inline constexpr const char* kLargestMetadata = "splatbus.largest";      ///< at the end: tensors' bytes by topic

/// A message on its way to the disk.
struct QueuedMessage {
  std::string topic;
  std::string schema;  ///< "EngineFrame/3"
  bool latched = false;
  std::string latch_key;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0, publish_time = 0;  ///< nanoseconds since 1970
  TopicRecords missing;                          ///< what was dropped between the one before and this one
  std::shared_ptr<const Blob> data;
};

struct TopicCount {
  std::uint64_t messages = 0, bytes = 0;
  TopicCount& operator+=(const TopicCount& other) {
    messages += other.messages;
    bytes += other.bytes;
    return *this;
  }
};

struct RecordingFileOptions {
  mcap::WriterOptions writer;
  std::vector<mcap::Metadata> metadata;                              ///< at the start of each part
  std::uint64_t max_bytes = 0;                                       ///< of a part, about; 0: no limit
  bool split = false;                                                ///< beyond `max_bytes` goes on with another part
  std::function<std::unique_ptr<mcap::Output>(unsigned part)> open;  ///< the first is 0
};

/// The disk's side of a recording: one file, or parts of which each can be played without those before it, as it begins
/// with what was latched then (256 MiB at most). Not thread-safe. Everything throws mcap::Error when the output does.
class RecordingFile {
 public:
  explicit RecordingFile(RecordingFileOptions options);

  void write(const QueuedMessage& message);
  void close_chunk();
  /// `missing`: what was dropped since the last message. The metadata has it with all that was missing of this part.
  void close(const TopicRecords& missing = {});

  /// Whether it has reached its limit and takes no more.
  [[nodiscard]] bool full() const;
  [[nodiscard]] std::uint64_t bytes() const { return closed_bytes_ + writer_->bytes(); }
  [[nodiscard]] unsigned parts() const { return part_ + 1; }
  /// By topic, what write() has been given that is in no closed chunk: lost, once the output has failed.
  [[nodiscard]] const std::map<std::string, TopicCount>& unwritten() const { return unwritten_; }

 private:
  void begin_part();
  void add_missing(const TopicRecords& missing);
  void next_part(std::uint64_t log_time);
  void append(const QueuedMessage& message);
  void hold(const QueuedMessage& message);
  std::uint16_t channel_of(const QueuedMessage& message);
  std::uint16_t schema_of(const std::string& schema);

  const RecordingFileOptions options_;
  std::unique_ptr<mcap::Writer> writer_;
  unsigned part_ = 0;
  std::uint64_t closed_bytes_ = 0;
  std::map<std::pair<std::string, std::string>, std::uint16_t> channels_;  ///< by topic and schema
  std::map<std::string, std::uint16_t> schemas_;
  std::map<std::string, std::uint64_t> largest_;
  std::map<std::string, TopicCount> unwritten_;
  TopicRecords missing_;                                                  ///< of this part
  std::map<std::pair<std::string, std::string>, QueuedMessage> latched_;  ///< by topic and latch key
  std::size_t latched_bytes_ = 0;
};

}  // namespace splatbus::cli
