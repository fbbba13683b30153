#include "capture-bridge/seniority.h"

#include <algorithm>

#include "wire/system_generated.h"

namespace splatbus::capture_bridge {

bool is_incomplete(const wire::Liveness& liveness) {
  constexpr std::int64_t kHeardByNs = 1'000'000'000;  // heartbeats come five times a second
  const wire::Header& header = *liveness.header();
  return header.publish_ns() - static_cast<std::int64_t>(header.epoch()) < kHeardByNs;
}

bool has_come_again(const wire::Liveness& liveness) {
  return liveness.nodes() != nullptr && std::ranges::any_of(*liveness.nodes(), [&](const wire::Node* node) {
           return node->alive() && node->epoch() < liveness.header()->epoch();
         });
}

std::vector<Senior> running(const wire::Liveness& liveness, std::string_view kind) {
  std::vector<Senior> seniors;
  if (liveness.nodes() == nullptr) return seniors;
  for (const wire::Node* node : *liveness.nodes()) {
    if (!node->alive() || node->state() != wire::ServiceState::Running || node->service()->string_view() != kind) {
      continue;
    }
    seniors.push_back({.since_ns = node->epoch(), .name = node->source()->str()});
  }
  std::ranges::sort(seniors);
  if (seniors.size() > kMaxSeniors) seniors.resize(kMaxSeniors);
  return seniors;
}

}  // namespace splatbus::capture_bridge
