#include "bus/heartbeat_check.h"

#include <fmt/format.h>

#include "bus/heartbeat_limits.h"

namespace splatbus::bus_service {
namespace {

using Limits = bus::HeartbeatLimits;

std::string too_long(const char* field, const flatbuffers::String* text, std::size_t limit) {
  if (text == nullptr || text->size() <= limit) return {};
  return fmt::format("{} has {} bytes, at most {} are allowed", field, text->size(), limit);
}

std::string too_many(const char* field, std::size_t entries) {
  if (entries <= Limits::kEntries) return {};
  return fmt::format("it has {} {}, at most {} are allowed", entries, field, Limits::kEntries);
}

}  // namespace

std::string heartbeat_problem(const wire::Heartbeat& heartbeat, std::size_t body_bytes) {
  if (body_bytes > Limits::kBytes) {
    return fmt::format("a heartbeat of {} bytes, at most {} are allowed", body_bytes, Limits::kBytes);
  }
  std::string wrong = too_long("its source", heartbeat.header()->source(), Limits::kName);
  if (wrong.empty()) wrong = too_long("its service", heartbeat.service(), Limits::kName);
  if (wrong.empty()) wrong = too_long("its backend", heartbeat.backend(), Limits::kName);
  if (wrong.empty()) wrong = too_long("its detail", heartbeat.detail(), Limits::kText);
  if (wrong.empty() && heartbeat.counters() != nullptr) {
    wrong = too_many("counters", heartbeat.counters()->size());
    for (const auto* counter : *heartbeat.counters()) {
      if (wrong.empty()) wrong = too_long("the name of a counter", counter->name(), Limits::kKey);
    }
  }
  if (wrong.empty() && heartbeat.parameters() != nullptr) {
    wrong = too_many("parameters", heartbeat.parameters()->size());
    for (const auto* parameter : *heartbeat.parameters()) {
      if (wrong.empty()) wrong = too_long("the name of a parameter", parameter->key(), Limits::kKey);
      if (wrong.empty()) wrong = too_long("the value of a parameter", parameter->value(), Limits::kText);
    }
  }
  return wrong;
}

}  // namespace splatbus::bus_service
