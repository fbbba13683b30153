#include "gateway/bench_log.h"

#include <spdlog/spdlog.h>

#include <utility>

#include "bus/frames.h"

namespace splatbus::gateway {

std::string BenchLog::add(std::string_view text) {
  if (text.size() > kMaxBytes) return "too large";
  bool deep = false;
  // Refused values are dropped as they are parsed, so that no deep tree is ever made.
  const auto shallow = [&](int depth, nlohmann::json::parse_event_t, const nlohmann::json&) {
    deep = deep || depth > kMaxDepth;
    return depth <= kMaxDepth;
  };
  nlohmann::json report = nlohmann::json::parse(text, shallow, false);
  if (deep || !report.is_object()) return "a JSON object of few levels was expected";
  if (log_limiter_.allow()) spdlog::info("bench: {}", bus::printable(report.dump(-1, ' ', true), 1024));
  if (reports_.size() == kKept) reports_.pop_front();
  reports_.push_back(std::move(report));
  return {};
}

}  // namespace splatbus::gateway
