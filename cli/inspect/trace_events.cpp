#include "trace_events.h"

#include <algorithm>
#include <set>
#include <utility>

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

double microseconds(std::int64_t ns) {
  return static_cast<double>(ns) / 1e3;
}

/// The names of processes and threads.
void add_names(const std::vector<TracedSpan>& spans, Json& events) {
  std::set<std::uint32_t> processes;
  std::set<std::pair<std::uint32_t, std::uint32_t>> threads;
  for (const TracedSpan& span : spans) {
    if (processes.insert(span.pid).second) {
      events.push_back({{"ph", "M"}, {"name", "process_name"}, {"pid", span.pid}, {"args", {{"name", span.source}}}});
    }
    if (!threads.insert({span.pid, span.thread}).second) continue;
    events.push_back({{"ph", "M"},
                      {"name", "thread_name"},
                      {"pid", span.pid},
                      {"tid", span.thread},
                      {"args", {{"name", span.pid == span.thread ? "main" : span.name}}}});
  }
}

Json event(const char* phase, const TracedSpan& span, std::int64_t at_ns) {
  return {{"ph", phase}, {"pid", span.pid}, {"tid", span.thread}, {"ts", microseconds(at_ns)}};
}

}  // namespace

void assign_frames(std::vector<TracedSpan>& spans) {
  std::map<std::uint64_t, std::set<std::int64_t>> frames;
  for (const TracedSpan& span : spans) {
    if (span.scene_version != 0 && span.capture_ns != 0) frames[span.scene_version].insert(span.capture_ns);
  }
  const auto newest_until = [](const std::set<std::int64_t>& captured, std::int64_t time_ns) {
    const auto after = captured.upper_bound(time_ns);
    return after == captured.begin() ? 0 : *std::prev(after);
  };
  std::set<std::int64_t> all;
  for (const auto& [version, captured] : frames) all.insert(captured.begin(), captured.end());
  for (TracedSpan& span : spans) {
    if (span.capture_ns == 0 && span.scene_version != 0) {
      const auto found = frames.find(span.scene_version);
      if (found != frames.end()) span.capture_ns = newest_until(found->second, span.end_ns);
    } else if (span.capture_ns != 0 && span.scene_version == 0) {
      // A viewer draws what was between two frames.
      if (const std::int64_t frame = newest_until(all, span.capture_ns); frame != 0) span.capture_ns = frame;
    }
  }
  std::stable_sort(spans.begin(), spans.end(),
                   [](const TracedSpan& a, const TracedSpan& b) { return a.begin_ns < b.begin_ns; });
}

std::map<std::int64_t, std::vector<const TracedSpan*>> ways_of_frames(const std::vector<TracedSpan>& spans) {
  std::map<std::int64_t, std::vector<const TracedSpan*>> ways;
  std::set<std::tuple<std::int64_t, std::uint32_t, std::string>> seen;
  for (const TracedSpan& span : spans) {
    if (span.capture_ns == 0 || !seen.insert({span.capture_ns, span.pid, span.name}).second) continue;
    ways[span.capture_ns].push_back(&span);
  }
  return ways;
}

Json trace_events(const std::vector<TracedSpan>& spans) {
  Json events = Json::array();
  add_names(spans, events);
  for (const TracedSpan& span : spans) {
    Json slice = event("X", span, span.begin_ns);
    slice["name"] = span.name;
    slice["cat"] = "splatbus";
    slice["dur"] = microseconds(span.end_ns - span.begin_ns);
    if (span.capture_ns != 0) slice["args"]["capture_ns"] = span.capture_ns;
    if (span.capture_ns != 0) slice["args"]["since_capture_ms"] = microseconds(span.begin_ns - span.capture_ns) / 1e3;
    if (span.scene_version != 0) slice["args"]["scene_version"] = span.scene_version;
    events.push_back(std::move(slice));
  }
  std::uint64_t arrow = 0;
  for (const auto& [capture_ns, way] : ways_of_frames(spans)) {
    for (std::size_t i = 1; i < way.size(); ++i) {
      ++arrow;
      // Each end lies within its slice, which is what it is bound to.
      Json from = event("s", *way[i - 1], way[i - 1]->begin_ns), to = event("f", *way[i], way[i]->begin_ns);
      to["bp"] = "e";
      for (Json* end : {&from, &to}) {
        (*end)["id"] = arrow;
        (*end)["name"] = "frame";
        (*end)["cat"] = "frame";
        events.push_back(std::move(*end));
      }
    }
  }
  return {{"displayTimeUnit", "ms"}, {"traceEvents", std::move(events)}};
}

}  // namespace splatbus::cli
