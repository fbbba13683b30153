#pragma once

#include <atomic>
#include <cstdint>
#include <mutex>
#include <vector>

namespace splatbus::bus {

/// One piece of work, as WorkSpan of schemas/trace.fbs.
struct WorkSpan {
  const char* name = nullptr;  ///< lives as long as the process
  std::int64_t begin_ns = 0, end_ns = 0;
  std::int64_t capture_ns = 0;
  std::uint64_t scene_version = 0;
  std::uint32_t thread = 0;
};

/// What the threads of this process do, for `splatbus trace`. Nothing is kept, and no clock is read, unless somebody
/// asked. Any thread.
class SpanLog {
 public:
  static constexpr std::size_t kMaxSpans = 4096;  ///< between two messages

  static SpanLog& of_process();

  /// Until that time of CLOCK_MONOTONIC.
  void record_until(std::int64_t until_ns) { until_ns_.store(until_ns, std::memory_order_relaxed); }
  [[nodiscard]] bool records() const;
  void add(const WorkSpan& span);

  struct Taken {
    std::vector<WorkSpan> spans;
    std::uint32_t lost = 0;
  };
  /// What has come since the last call.
  [[nodiscard]] Taken take();

 private:
  std::atomic<std::int64_t> until_ns_{0};
  std::mutex mutex_;
  Taken kept_;
};

/// Records the time from here to the end of its block.
class TracedWork {
 public:
  explicit TracedWork(const char* name, std::int64_t capture_ns = 0, std::uint64_t scene_version = 0);
  ~TracedWork();
  TracedWork(const TracedWork&) = delete;
  TracedWork& operator=(const TracedWork&) = delete;

  /// Once it is known of which frame it is.
  void is_of(std::int64_t capture_ns, std::uint64_t scene_version);
  /// It was no work after all.
  void drop() { span_.begin_ns = 0; }

 private:
  WorkSpan span_;
};

}  // namespace splatbus::bus
