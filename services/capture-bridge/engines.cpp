#include "capture-bridge/engines.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <iterator>

#include "bus/frames.h"
#include "wire/system_generated.h"

namespace splatbus::capture_bridge {

namespace {

constexpr double kLongestBetweenNs = 3.6e12;  // two pictures, however low a rate is

/// The others belong to the lead's frames, or are wanted at once.
bool is_divided(CameraRole role) {
  return role == CameraRole::Input || role == CameraRole::Reference;
}

}  // namespace

void Engines::take(const wire::Liveness& liveness) {
  if (is_incomplete(liveness) && !running_.empty()) return;
  running_ = running(liveness, "engine");
  std::erase_if(conduct_,
                [&](const auto& entry) { return std::ranges::count(running_, entry.first, &Senior::name) == 0; });
  choose();
}

void Engines::update(std::int64_t now_ns) {
  // Where nobody brings anything there is nobody to have the cameras.
  const bool all_idle = std::ranges::all_of(in_use_, [&](const Senior& engine) { return idles(engine, now_ns); });
  for (const Senior& engine : in_use_) {
    if (all_idle || !idles(engine, now_ns)) continue;
    Conduct& conduct = conduct_[engine.name];
    spdlog::warn("{} brings no picture of a scene that is known: for {} s the other engines have its cameras",
                 bus::printable(engine.name), conduct.next_rest_ns / 1'000'000'000);
    conduct.rests_until_ns = now_ns + conduct.next_rest_ns;
    conduct.next_rest_ns = std::min(2 * conduct.next_rest_ns, kMostRestNs);
    conduct.asked_ns.reset();
    conduct.brought_ns.reset();
  }
  for (auto& [name, conduct] : conduct_) {
    if (!conduct.rests_until_ns || now_ns < *conduct.rests_until_ns) continue;
    conduct.rests_until_ns.reset();
    conduct.back_since_ns = static_cast<std::uint64_t>(now_ns);
  }
  choose();
}

bool Engines::idles(const Senior& engine, std::int64_t now_ns) const {
  const auto conduct = conduct_.find(engine.name);
  if (conduct == conduct_.end()) return false;
  const std::optional<std::int64_t> since_ns = conduct->second.waits_since_ns();
  return since_ns && now_ns - *since_ns > kPatienceNs;
}

std::optional<std::int64_t> Engines::Conduct::waits_since_ns() const {
  if (asked_ns || !brought_ns || !(rate_hz > 0)) return asked_ns;
  return *brought_ns + std::llround(std::min(1e9 / static_cast<double>(rate_hz), kLongestBetweenNs));
}

void Engines::choose() {
  std::vector<Senior> chosen;
  for (Senior engine : running_) {
    const Conduct& conduct = conduct_[engine.name];
    if (conduct.rests_until_ns) continue;
    engine.since_ns = std::max(engine.since_ns, conduct.back_since_ns);
    chosen.push_back(std::move(engine));
  }
  std::ranges::sort(chosen);
  if (chosen == in_use_) return;
  in_use_ = std::move(chosen);
  shared_ = shared_ || in_use_.size() > 1;
  if (!shared_) return;
  changed_ = uneven_ = true;
  std::string names;
  for (const Senior& engine : in_use_) names += (names.empty() ? "" : ", ") + bus::printable(engine.name);
  spdlog::info("engines that have the cameras, who leads first: {}", names.empty() ? "none" : names);
}

void Engines::brought(const std::string& source, std::int64_t now_ns) {
  const auto conduct = conduct_.find(source);
  if (conduct == conduct_.end()) return;
  conduct->second.asked_ns.reset();
  conduct->second.brought_ns = now_ns;
  conduct->second.next_rest_ns = kRestNs;
}

std::map<std::string, std::vector<CameraRequest>> Engines::divide(const std::vector<CameraRequest>& requests,
                                                                  std::int64_t now_ns) {
  share_out(requests);
  std::map<std::string, std::vector<CameraRequest>> sets;
  for (const std::string& name : named_) sets[name];
  named_.clear();
  for (const Senior& engine : in_use_) {
    sets[engine.name];
    named_.insert(engine.name);
  }
  for (auto& [name, conduct] : conduct_) conduct.rate_hz = 0;
  for (const CameraRequest& request : requests) {
    const auto share = shares_.find({request.camera.role, request.camera.id});
    if (share == shares_.end()) continue;  // there is no engine
    sets[share->second.engine].push_back(request);
    const bool anew = std::exchange(share->second.request_id, request.request_id) != request.request_id;
    // A light that casts no shadow just now has no depth maps, however often they are asked for.
    if (request.camera.role == CameraRole::Light) continue;
    Conduct& conduct = conduct_[share->second.engine];
    conduct.rate_hz = std::max(conduct.rate_hz, request.rate_hz);
    if (anew && !conduct.asked_ns) conduct.asked_ns = now_ns;
  }
  return sets;
}

void Engines::share_out(const std::vector<CameraRequest>& requests) {
  std::map<Key, Share> before = std::exchange(shares_, {});
  if (in_use_.empty()) return;
  // Each role by itself: pictures of one may come at a rate while those of the other stand.
  std::map<CameraRole, Loads> loads;
  for (const Senior& engine : in_use_) {
    for (const CameraRole role : {CameraRole::Input, CameraRole::Reference}) loads[role][engine.name] = 0;
  }
  const std::string& lead = in_use_.front().name;
  std::vector<Key> homeless;
  for (const CameraRequest& request : requests) {
    const Key key(request.camera.role, request.camera.id);
    const auto had = before.find(key);
    const bool known = had != before.end() && loads[CameraRole::Input].contains(had->second.engine);
    if (is_divided(key.first) && !known) {
      homeless.push_back(key);
      continue;
    }
    const bool stays = known && (is_divided(key.first) || had->second.engine == lead);
    const Share& share = shares_.emplace(key, stays ? had->second : Share{.engine = lead}).first->second;
    ++loads[is_divided(key.first) ? key.first : CameraRole::Input][share.engine];
  }
  for (const Key& key : homeless) {
    Loads& of_role = loads[key.first];
    const Senior& least = *std::ranges::min_element(in_use_, {}, [&](const Senior& one) { return of_role[one.name]; });
    shares_.emplace(key, Share{.engine = least.name});
    ++of_role[least.name];
  }
  if (std::exchange(uneven_, false)) even_out(loads);
}

/// The lead's cameras that are not divided count: it has fewer input cameras for them.
void Engines::even_out(std::map<CameraRole, Loads>& loads) {
  for (auto& [camera, share] : shares_) {
    if (!is_divided(camera.first)) continue;
    Loads& of_role = loads[camera.first];
    const auto least = std::ranges::min_element(of_role, {}, [](const auto& load) { return load.second; });
    std::size_t& load = of_role[share.engine];
    if (load < least->second + 2) continue;
    share = {.engine = least->first};
    --load;
    ++least->second;
  }
}

}  // namespace splatbus::capture_bridge
