#include "relight/page_shares.h"

#include <algorithm>
#include <utility>

#include "bus/rendezvous.h"
#include "wire/system_generated.h"

namespace splatbus::relight {

bool PageShares::take(const wire::Liveness& liveness) {
  heard_ = true;
  std::vector<std::string> sources{own_};
  if (liveness.nodes() != nullptr) {
    for (const auto* node : *liveness.nodes()) {
      const bool computes = node->alive() && node->state() == wire::ServiceState::Running;
      if (!computes || node->service()->string_view() != "relight" || node->source()->string_view() == own_) continue;
      if (sources.size() < kMaxReplicas) sources.push_back(node->source()->str());
    }
  }
  std::ranges::sort(sources);
  return std::exchange(sources_, sources) != sources;
}

bool PageShares::owns(std::uint32_t page) const {
  const auto weight = [page](const std::string& source) {
    return std::pair(bus::rendezvous_weight(bus::hash_of(source), page), source);
  };
  return *std::ranges::max_element(sources_, {}, weight) == own_;
}

std::uint32_t PageShares::part() const {
  return static_cast<std::uint32_t>(std::ranges::find(sources_, own_) - sources_.begin());
}

std::uint64_t PageShares::division() const {
  std::uint64_t hash = 0;
  for (const std::string& source : sources_) hash = bus::mixed(hash ^ bus::hash_of(source));
  return hash;
}

}  // namespace splatbus::relight
