#include "bus/trace.h"

#include <unistd.h>

#include <utility>

#include "bus/clock.h"

namespace splatbus::bus {

SpanLog& SpanLog::of_process() {
  static SpanLog log;
  return log;
}

bool SpanLog::records() const {
  const std::int64_t until = until_ns_.load(std::memory_order_relaxed);
  return until != 0 && now_ns() < until;
}

void SpanLog::add(const WorkSpan& span) {
  const std::scoped_lock lock(mutex_);
  if (kept_.spans.size() >= kMaxSpans) {
    ++kept_.lost;
  } else {
    kept_.spans.push_back(span);
  }
}

SpanLog::Taken SpanLog::take() {
  const std::scoped_lock lock(mutex_);
  return std::exchange(kept_, {});
}

TracedWork::TracedWork(const char* name, std::int64_t capture_ns, std::uint64_t scene_version) {
  if (!SpanLog::of_process().records()) return;
  span_ = {.name = name, .begin_ns = now_ns(), .capture_ns = capture_ns, .scene_version = scene_version};
}

TracedWork::~TracedWork() {
  if (span_.begin_ns == 0) return;
  span_.end_ns = now_ns();
  span_.thread = static_cast<std::uint32_t>(::gettid());
  SpanLog::of_process().add(span_);
}

void TracedWork::is_of(std::int64_t capture_ns, std::uint64_t scene_version) {
  span_.capture_ns = capture_ns;
  span_.scene_version = scene_version;
}

}  // namespace splatbus::bus
