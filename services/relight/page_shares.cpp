#include "relight/page_shares.h"

#include <algorithm>
#include <utility>

#include "wire/system_generated.h"

namespace splatbus::relight {

namespace {

/// FNV-1a; every replica computes the same, whatever its standard library.
std::uint64_t hash_of(std::string_view text) {
  std::uint64_t hash = 0xcbf29ce484222325U;
  for (const char c : text) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3U;
  return hash;
}

/// SplitMix64's finaliser.
std::uint64_t mixed(std::uint64_t x) {
  x = (x ^ (x >> 30U)) * 0xbf58476d1ce4e5b9U;
  x = (x ^ (x >> 27U)) * 0x94d049bb133111ebU;
  return x ^ (x >> 31U);
}

}  // namespace

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
    return std::pair(mixed(hash_of(source) + 0x9e3779b97f4a7c15U * (std::uint64_t{page} + 1)), source);
  };
  return *std::ranges::max_element(sources_, {}, weight) == own_;
}

std::uint32_t PageShares::part() const {
  return static_cast<std::uint32_t>(std::ranges::find(sources_, own_) - sources_.begin());
}

std::uint64_t PageShares::division() const {
  std::uint64_t hash = 0;
  for (const std::string& source : sources_) hash = mixed(hash ^ hash_of(source));
  return hash;
}

}  // namespace splatbus::relight
