#include "streamer/page_division.h"

#include <algorithm>
#include <tuple>
#include <utility>

#include "bus/rendezvous.h"

namespace splatbus::streamer {

PageDivision::PageDivision(std::vector<std::string> sources) : sources_(std::move(sources)) {
  for (const std::string& source : sources_) hashes_.push_back(bus::hash_of(source));
}

const std::string& PageDivision::owner_of(std::uint32_t page) const {
  if (sources_.size() <= 1) return sources_.empty() ? nobody_ : sources_.front();
  const std::uint32_t group = page / kGroup;
  const auto [known, is_new] = owners_.try_emplace(group);
  if (is_new) known->second = divide(group);
  return sources_[known->second[page % kGroup]];
}

// The heaviest pair of a page and a replica first, and so on, until each page has one. There is room for all of them.
PageDivision::Owners PageDivision::divide(std::uint32_t group) const {
  struct Pair {
    std::uint64_t weight;
    std::uint32_t page;
    std::uint8_t replica;
  };
  std::vector<Pair> pairs;
  for (std::uint32_t page = 0; page < kGroup; ++page) {
    for (std::size_t k = 0; k < sources_.size(); ++k) {
      pairs.push_back({bus::rendezvous_weight(hashes_[k], group * kGroup + page), page, static_cast<std::uint8_t>(k)});
    }
  }
  std::ranges::sort(pairs, [](const Pair& a, const Pair& b) {
    return std::tuple(a.weight, a.page, a.replica) > std::tuple(b.weight, b.page, b.replica);
  });
  const std::size_t room = (kGroup + sources_.size() - 1) / sources_.size();
  std::vector<std::size_t> load(sources_.size());
  std::array<bool, kGroup> taken{};
  Owners owners{};
  for (const Pair& pair : pairs) {
    if (taken[pair.page] || load[pair.replica] == room) continue;
    taken[pair.page] = true;
    ++load[pair.replica];
    owners[pair.page] = pair.replica;
  }
  return owners;
}

bool EncodedPages::contains(std::uint32_t page) const {
  if (left.contains(page)) return false;
  if (division.owner_of(page) == own) return true;
  return kept && std::ranges::binary_search(*kept, page, {}, &stream::OfferedPage::page);
}

PartOfModel::PartOfModel(const GaussiansView& whole, const EncodedPages& pages) : view(whole) {
  if (!whole.has_pages()) return;
  const bool bounds = whole.bounds.size() == whole.ranges.size();
  const bool generations = whole.generations.size() == whole.ranges.size();
  for (std::size_t k = 0; k < whole.ranges.size(); ++k) {
    const IndexRange& range = whole.ranges[k];
    all += range.count;
    if (!pages.contains(range.first >> whole.page_shift)) continue;
    own += range.count;
    ranges_.push_back(range);
    if (bounds) bounds_.push_back(whole.bounds[k]);
    if (generations) generations_.push_back(whole.generations[k]);
  }
  view.ranges = ranges_;
  view.bounds = bounds_;
  view.generations = generations_;
}

}  // namespace splatbus::streamer
