#include "topic_statistics.h"

namespace splatbus::cli {

void TopicStatistics::add(const bus::Message& message) {
  schemas.insert(message.header().schema()->str());
  sources.insert(message.header().source()->str());
  latched = latched || message.header().latch();
  if (message.header().resent()) ++resent;
  ++messages;
  bytes += message_bytes(message);
}

double TopicStatistics::rate_hz(std::int64_t window_ns) const {
  return window_ns > 0 ? static_cast<double>(messages - resent) * 1e9 / static_cast<double>(window_ns) : 0;
}

double TopicStatistics::megabits_per_s(std::int64_t window_ns) const {
  return window_ns > 0 ? static_cast<double>(bytes) * 8e3 / static_cast<double>(window_ns) : 0;
}

std::uint64_t message_bytes(const bus::Message& message) {
  std::uint64_t bytes = message.size();
  if (message.header().tensors() != nullptr) {
    for (const wire::Tensor* tensor : *message.header().tensors()) bytes += tensor->span()->bytes();
  }
  return bytes;
}

}  // namespace splatbus::cli
