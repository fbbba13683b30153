// What a WorldKeeper takes out of memory, and when it brings it back.

#include <spdlog/spdlog.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <set>
#include <utility>

#include "trainer/world_keeper.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kNoBound = std::numeric_limits<std::size_t>::max();
constexpr std::size_t kFetchedAtOnce = 64;
constexpr auto kFetchPeriod = std::chrono::milliseconds(50);  // of looks that have found all that is wanted
constexpr auto kHurryPeriod = std::chrono::milliseconds(100);
/// Times the distance of what is to come back: farther away, pages leave for it. What comes back so does not go at
/// once.
constexpr float kLeave = 1.25F;
/// Of a ceiling: where pages begin to leave, and where they end. Insertions have room meanwhile.
constexpr std::size_t kHighMargin = 16, kLowMargin = 8;
/// Of what folders may take on disk, what counts of them may be; the rest is for what no longer does.
constexpr std::size_t kLiveEighths = 5;

}  // namespace

std::size_t WorldKeeper::most_pages(const WorldParameters& parameters, const ParameterLayout& layout, Device device,
                                    double active_share) {
  const std::size_t bytes = device == Device::Cpu ? parameters.host_bytes : parameters.device_bytes;
  if (bytes == 0) return kNoBound;
  const PageCost cost(layout);
  const auto moments = static_cast<std::size_t>(active_share * static_cast<double>(cost.moments));
  return std::max<std::size_t>(8, bytes / (cost.all(false) + moments));
}

std::size_t WorldKeeper::bytes_here() const {
  const std::size_t pages = store_.page_count();
  // Memory of pages that have left between others is there for the next ones.
  const std::size_t places = std::max(pages, store_.view().count >> kPageShift);
  return places * cost_.page + pages * cost_.beside + (pages - store_.frozen_pages()) * cost_.moments;
}

WorldKeeper::Excess WorldKeeper::excess() const {
  const auto beyond = [](std::size_t here, std::size_t ceiling, std::size_t margin) {
    const std::size_t most = ceiling - ceiling / margin;
    return ceiling == 0 || here <= most ? 0 : here - most;
  };
  const std::size_t bytes = bytes_here();
  // Where nobody is said to look no page is farther than others: a full model takes nothing more then.
  const std::size_t ceiling_gaussians = places_.empty() ? 0 : ceiling_gaussians_;
  const bool is_high =
      beyond(bytes, ceiling_bytes_, kHighMargin) > 0 || beyond(store_.count(), ceiling_gaussians, kHighMargin) > 0;
  if (!is_high) return {};
  return {beyond(bytes, ceiling_bytes_, kLowMargin), beyond(store_.count(), ceiling_gaussians, kLowMargin)};
}

std::size_t WorldKeeper::room_for_pages() const {
  std::size_t most = kNoBound;
  if (ceiling_gaussians_ > 0) {
    const std::size_t high = ceiling_gaussians_ - ceiling_gaussians_ / kHighMargin;
    most = (high - std::min(high, store_.count())) / kPageLanes;
  }
  if (ceiling_bytes_ == 0) return most;
  const std::size_t places = store_.view().count >> kPageShift;
  const std::size_t gaps = places - std::min(places, store_.page_count());
  const std::size_t high = ceiling_bytes_ - ceiling_bytes_ / kHighMargin;
  const std::size_t left = high - std::min(high, bytes_here());
  const std::size_t in_gaps = std::min(gaps, left / (cost_.beside + cost_.moments));
  return std::min(most, in_gaps + (left - in_gaps * (cost_.beside + cost_.moments)) / cost_.all(true));
}

void WorldKeeper::see(std::vector<math::Vec3> places) {
  if (!places.empty()) places_ = std::move(places);
}

float WorldKeeper::distance_m(const world::PageKey& key, const PageBounds& bounds) const {
  // Where an object is, its pages do not say: they are always near.
  if (key.frame_id != kWorldFrame || places_.empty()) return 0;
  float nearest = std::numeric_limits<float>::infinity();
  for (const math::Vec3& at : places_) {
    const auto beyond = [](float x, float low, float high) { return std::max({low - x, x - high, 0.0F}); };
    nearest = std::min(nearest,
                       std::hypot(beyond(at.x, bounds.low.x, bounds.high.x), beyond(at.y, bounds.low.y, bounds.high.y),
                                  beyond(at.z, bounds.low.z, bounds.high.z)));
  }
  return nearest;
}

std::vector<WorldKeeper::Candidate> WorldKeeper::choose_victims() const {
  const Excess leaves = excess();
  if (leaves.bytes == 0 && leaves.gaussians == 0 && wanted_m_.empty()) return {};
  struct Far {
    float distance_m;
    Candidate candidate;
    std::size_t bytes, gaussians;
  };
  std::vector<Far> far;
  for (const IndexRange& range : store_.view().ranges) {
    const std::uint32_t page = range.first >> kPageShift;
    const model::PageEntry& entry = store_.table().entry(page);
    const world::PageKey key = key_of(entry.now);
    if (key.frame_id != kWorldFrame) continue;
    const bool trains = entry.now.state != model::PageState::Frozen;
    far.push_back(
        {distance_m(key, entry.bounds), {key, page, 0}, cost_.beside + (trains ? cost_.moments : 0), entry.now.count});
  }
  std::sort(far.begin(), far.end(), [](const Far& a, const Far& b) {
    return a.distance_m != b.distance_m ? a.distance_m > b.distance_m : a.candidate.key < b.candidate.key;
  });
  std::vector<Candidate> victims;
  Excess freed;
  std::size_t replaced = 0;
  for (const Far& page : far) {
    if (freed.bytes < leaves.bytes || freed.gaussians < leaves.gaussians) {
      freed.bytes += page.bytes;
      freed.gaussians += page.gaussians;
    } else if (replaced < wanted_m_.size() && page.distance_m > kLeave * wanted_m_[replaced]) {
      ++replaced;
    } else {
      break;
    }
    victims.push_back(page.candidate);
  }
  return victims;
}

bool WorldKeeper::is_kept(const Candidate& candidate) const {
  const auto kept = kept_.find(candidate.key);
  const model::PageEntry& entry = store_.table().entry(candidate.page);
  return kept != kept_.end() && entry.now.state == model::PageState::Frozen &&
         kept->second.generation == entry.generation.load(std::memory_order_relaxed);
}

bool WorldKeeper::hurries(Clock::time_point now) {
  if (failing_ || wanted_m_.empty() || now < next_hurry_) return false;
  next_hurry_ = now + kHurryPeriod;
  return !choose_victims().empty();
}

void WorldKeeper::spill(const KeepRound& round, const Restructure& restructure) {
  const auto leaves = [&](const StagedPage& page) { return page.mark == world::PageMark::Spilled; };
  const std::span<const StagedPage> staged(round.pages.data(), round.used);
  std::vector<world::PageKey> leaving = round.leaving;
  for (const StagedPage& page : staged) {
    if (leaves(page)) leaving.push_back(page.key);
  }
  if (leaving.empty()) return;
  restructure([&] {
    std::vector<std::uint32_t> pages;
    for (const world::PageKey& key : leaving) {
      const auto kept = kept_.find(key);
      const auto entry = world_->find(key);
      if (kept == kept_.end() || !entry) continue;
      // What has changed since goes another time, and to the folder as it is now.
      if (store_.table().entry(kept->second.page).generation.load() != kept->second.generation) {
        kept->second.generation = 0;
        continue;
      }
      pages.push_back(kept->second.page);
      elsewhere_[key] = *entry;
      kept_.erase(kept);
    }
    store_.take_out(pages);
    tell_spilled();
    spdlog::debug("world: {} pages are on disk alone now, {} of them since", elsewhere_.size(), pages.size());
  });
}

void WorldKeeper::forget(KeepRound& round) {
  if (parameters_.disk_bytes == 0) return;
  const std::uint64_t most_live = parameters_.disk_bytes / 8 * kLiveEighths;
  std::uint64_t live = world_->live_bytes();
  if (live <= most_live) return;
  std::vector<std::pair<float, world::PageKey>> far;
  for (const auto& [key, entry] : elsewhere_) far.emplace_back(distance_m(key, entry.bounds), key);
  std::sort(far.begin(), far.end(), std::greater<>());
  for (const auto& [distance, key] : far) {
    if (live <= most_live) break;
    if (std::find(reading_.begin(), reading_.end(), key) != reading_.end()) continue;
    live -= elsewhere_.at(key).bytes;
    kept_[key] = {};  // so that a round that fails is made up for
    round.removals.push_back(key);
    elsewhere_.erase(key);
  }
  tell_spilled();
}

void WorldKeeper::start_fetch(const std::vector<world::PageKey>& arriving) {
  if (!reading_.empty()) return;
  if (elsewhere_.empty() || places_.empty()) {
    wanted_m_.clear();
    return;
  }
  // Not with each step: all that was ever spilled is looked at.
  const auto now = Clock::now();
  if (now < next_fetch_) return;
  next_fetch_ = now + kFetchPeriod;
  std::vector<std::pair<float, world::PageKey>> near;
  for (const auto& [key, entry] : elsewhere_) {
    const float distance = distance_m(key, entry.bounds);
    if (distance <= parameters_.fetch_m) near.emplace_back(distance, key);
  }
  if (!arriving.empty()) {
    const std::set<world::PageKey> come(arriving.begin(), arriving.end());
    std::erase_if(near, [&](const auto& page) { return come.contains(page.second); });
  }
  std::sort(near.begin(), near.end());
  const std::size_t room = room_for_pages() - std::min(room_for_pages(), arriving.size());
  const std::size_t count = std::min({near.size(), room, kFetchedAtOnce});
  if (count < std::min(near.size(), room)) next_fetch_ = now;
  wanted_m_.clear();
  for (std::size_t k = room; k < near.size(); ++k) wanted_m_.push_back(near[k].first);
  for (std::size_t k = 0; k < count; ++k) reading_.push_back(near[k].second);
  if (reading_.empty()) return;
  read_ = std::async(std::launch::async, [world = world_, keys = reading_] {
    Pages pages(keys.size());
    tbb::parallel_for(std::size_t{0}, keys.size(), [&](std::size_t k) { pages[k] = world->read(keys[k]); });
    return pages;
  });
}

void WorldKeeper::finish_fetch(const Restructure& restructure) {
  if (reading_.empty() || read_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return;
  Pages pages = read_.get();
  const std::vector<world::PageKey> keys = std::exchange(reading_, {});
  start_fetch(keys);  // the next ones are read while these are put in
  restructure([&] {
    const std::vector<std::uint32_t> placed = put_in(pages, store_.next_gaussian_id());
    for (std::size_t p = 0; p < placed.size(); ++p) {
      const world::PageKey& key = keys[p];
      const bool is_in = placed[p] != model::kNotInserted;
      if (!is_in && pages[p] && (store_.room() < pages[p]->count || !store_.has_page())) continue;  // another time
      kept_[key] = is_in ? kept_as(*pages[p], placed[p], store_.step()) : Kept{};
      elsewhere_.erase(key);
    }
    tell_spilled();
  });
}

void WorldKeeper::tell_spilled() {
  std::vector<model::SpilledRange> ranges;
  ranges.reserve(elsewhere_.size());
  for (const auto& [key, entry] : elsewhere_) {
    ranges.push_back({.frame_id = key.frame_id,
                      .morton_first = key.morton,
                      .id_first = key.id,
                      .morton_last = entry.morton_last,
                      .low_m = entry.bounds.low,
                      .high_m = entry.bounds.high});
  }
  store_.set_spilled(std::move(ranges));
}

}  // namespace splatbus::trainer
