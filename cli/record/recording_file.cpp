#include "recording_file.h"

#include <flatbuffers/flatbuffers.h>

#include <algorithm>
#include <span>

#include "wire/schemas.h"

namespace splatbus::cli {

namespace {

constexpr std::size_t kMaxLatchedBytes = std::size_t{256} << 20;

/// Bytes of the tensors that lie in the message's data.
std::uint64_t tensor_bytes_in(const QueuedMessage& message) {
  std::uint64_t bytes = 0;
  const auto* tensors = flatbuffers::GetRoot<wire::Envelope>(message.data->data.get())->header()->tensors();
  if (tensors == nullptr) return 0;
  for (const wire::Tensor* tensor : *tensors) {
    if (tensor->span()->storage() == wire::Storage::Inline) bytes += bus::aligned(tensor->span()->bytes());
  }
  return bytes;
}

}  // namespace

RecordingFile::RecordingFile(RecordingFileOptions options) : options_(std::move(options)) {
  begin_part();
}

void RecordingFile::begin_part() {
  writer_ = std::make_unique<mcap::Writer>(options_.open(part_), options_.writer);
  for (const mcap::Metadata& metadata : options_.metadata) writer_->write(metadata);
}

bool RecordingFile::full() const {
  return !options_.split && options_.max_bytes > 0 && writer_->bytes() >= options_.max_bytes;
}

void RecordingFile::write(const QueuedMessage& message) {
  const bool split = options_.split && options_.max_bytes > 0 && writer_->bytes() >= options_.max_bytes;
  const auto count = [&] { unwritten_[message.topic] += {.messages = 1, .bytes = message.data->size}; };
  count();
  if (split) {
    close();
    count();
    next_part(message.log_time);
  }
  add_missing(message.missing);
  append(message);
  if (options_.split && message.latched) hold(message);
  if (writer_->open_chunk_bytes() == 0) unwritten_.clear();
}

void RecordingFile::close_chunk() {
  writer_->close_chunk();
  unwritten_.clear();
}

void RecordingFile::next_part(std::uint64_t log_time) {
  closed_bytes_ += writer_->bytes();
  ++part_;
  channels_.clear();
  schemas_.clear();
  missing_.clear();
  begin_part();
  std::vector<const QueuedMessage*> held;
  for (const auto& [key, message] : latched_) held.push_back(&message);
  std::ranges::sort(held, {}, &QueuedMessage::publish_time);
  for (const QueuedMessage* message : held) {
    QueuedMessage repeated = *message;
    repeated.log_time = log_time;
    append(repeated);
  }
}

void RecordingFile::add_missing(const TopicRecords& missing) {
  for (const auto& [topic, record] : missing) missing_[topic] += record;
}

void RecordingFile::append(const QueuedMessage& message) {
  auto& largest = largest_[message.topic];
  largest = std::max(largest, tensor_bytes_in(message));
  writer_->write(mcap::Message{.channel_id = channel_of(message),
                               .sequence = message.sequence,
                               .log_time = message.log_time,
                               .publish_time = message.publish_time,
                               .data = message.data->bytes()});
}

void RecordingFile::hold(const QueuedMessage& message) {
  const std::pair key(message.topic, message.latch_key);
  if (const auto found = latched_.find(key); found != latched_.end()) {
    latched_bytes_ -= found->second.data->size;
    latched_.erase(found);
  }
  if (latched_bytes_ + message.data->size > kMaxLatchedBytes) return;
  latched_bytes_ += message.data->size;
  latched_.emplace(key, message).first->second.missing.clear();
}

std::uint16_t RecordingFile::channel_of(const QueuedMessage& message) {
  const std::pair key(message.topic, message.schema);
  if (const auto found = channels_.find(key); found != channels_.end()) return found->second;
  const std::uint16_t schema = schema_of(message.schema);
  const std::uint16_t channel =
      writer_->add_channel(schema, message.topic, "flatbuffer",
                           {{"schema", message.schema}, {"latched", message.latched ? "true" : "false"}});
  return channels_[key] = channel;
}

std::uint16_t RecordingFile::schema_of(const std::string& schema) {
  if (const auto found = schemas_.find(schema); found != schemas_.end()) return found->second;
  std::uint16_t id = 0;
  if (const auto known = wire::find_schema(schema)) {
    const auto bytes = std::as_bytes(known->binary);
    id = writer_->add_schema(std::string(known->table), "flatbuffer", {bytes.begin(), bytes.end()});
  }
  return schemas_[schema] = id;
}

void RecordingFile::close(const TopicRecords& missing) {
  close_chunk();
  add_missing(missing);
  mcap::StringMap drops;
  for (const auto& [topic, record] : missing_) drops[topic] = describe_drops(record);
  mcap::Metadata largest{.name = kLargestMetadata, .values = {}};
  for (const auto& [topic, bytes] : largest_) {
    if (bytes > 0) largest.values[topic] = std::to_string(bytes);
  }
  writer_->write(largest);
  writer_->write(mcap::Metadata{.name = kDropsMetadata, .values = drops});
  writer_->close();
}

}  // namespace splatbus::cli
