#include "topic_statistics.h"

namespace splatbus::cli {

void TopicStatistics::add(const bus::Message& message, std::int64_t now_ns) {
  schemas.insert(message.header().schema()->str());
  sources.insert(message.header().source()->str());
  latched = latched || message.header().latch();
  bytes += message_bytes(message);
  if (++messages == 1) first_ns = now_ns;
  last_ns = now_ns;
}

double TopicStatistics::rate_hz() const {
  if (messages < 2 || last_ns == first_ns) return 0;
  return static_cast<double>(messages - 1) * 1e9 / static_cast<double>(last_ns - first_ns);
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
