#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace splatbus::cli {

/// One piece of work of one process, as sys/spans says it.
struct TracedSpan {
  std::string source, name;
  std::uint32_t pid = 0, thread = 0;
  std::int64_t begin_ns = 0, end_ns = 0;
  std::int64_t capture_ns = 0;  ///< of the engine frame that it is of; 0: of none, or not known
  std::uint64_t scene_version = 0;
};

/// Which engine frame each span is of. Frames are known from the spans that say both capture_ns and scene version. A
/// span that says its scene version alone is of the newest such frame of that version captured before it ended; one
/// that says an instant alone, of the newest frame captured until then. Then sorts the spans by their begin.
void assign_frames(std::vector<TracedSpan>& spans);

/// What became of each engine frame: the first span of each process and name, by begin. Frames by capture_ns.
[[nodiscard]] std::map<std::int64_t, std::vector<const TracedSpan*>> ways_of_frames(
    const std::vector<TracedSpan>& spans);

/// Chrome's trace event format, which Perfetto's UI reads: a track for each thread of each process, a slice for each
/// span, and arrows along the way of each engine frame. Times are microseconds of CLOCK_MONOTONIC.
[[nodiscard]] nlohmann::json trace_events(const std::vector<TracedSpan>& spans);

}  // namespace splatbus::cli
