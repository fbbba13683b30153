#include "capture-bridge/camera_shares.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>

namespace splatbus::capture_bridge {

std::vector<int> divide_cameras(int total, std::span<const float> needs, int least) {
  std::vector<int> shares(needs.size(), 0);
  if (needs.empty() || total <= 0) return shares;
  std::vector<std::size_t> order(needs.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::ranges::stable_sort(order, std::greater{}, [&](std::size_t i) { return needs[i]; });
  order.resize(std::min(order.size(), static_cast<std::size_t>(std::max(1, total / least))));
  const int each = std::min(least, total / static_cast<int>(order.size()));
  const int spare = total - each * static_cast<int>(order.size());
  float sum = 0;
  for (const std::size_t i : order) sum += needs[i];
  // Running sums are rounded, so that no camera is lost.
  float so_far = 0;
  int given = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    so_far += sum > 0 ? needs[order[k]] / sum : 1.0F / static_cast<float>(order.size());
    const bool last = k + 1 == order.size();
    const int upto = last ? spare : static_cast<int>(std::ceil(so_far * static_cast<float>(spare) - 1e-3F));
    shares[order[k]] = each + upto - given;
    given = upto;
  }
  return shares;
}

void CameraShares::set_total(int total) {
  total_ = total;
  for (auto& [owner, ids] : ids_) {
    std::erase_if(ids, [total](std::uint32_t id) { return id >= static_cast<std::uint32_t>(total); });
  }
}

std::span<const std::uint32_t> CameraShares::of(const std::string& owner) const {
  const auto found = ids_.find(owner);
  return found == ids_.end() ? std::span<const std::uint32_t>() : std::span<const std::uint32_t>(found->second);
}

void CameraShares::take_share(const std::string& owner, const Shares& shares) {
  const auto share = shares.find(owner);
  const auto wanted = static_cast<std::size_t>(share == shares.end() ? 0 : share->second);
  ids_.try_emplace(owner);
  while (ids_.at(owner).size() < wanted && take_one(owner, shares)) {
  }
  // Others take from the back, and engines render the smallest first: that is its eye.
  std::vector<std::uint32_t>& own = ids_.at(owner);
  if (!own.empty()) std::iter_swap(own.begin(), std::ranges::min_element(own));
}

bool CameraShares::take_one(const std::string& owner, const Shares& shares) {
  std::vector<bool> taken(static_cast<std::size_t>(total_), false);
  std::vector<std::uint32_t>* richest = nullptr;
  int beyond = 0;
  for (auto& [other, ids] : ids_) {
    for (const std::uint32_t id : ids) taken[id] = true;
    const auto share = shares.find(other);
    const int surplus = static_cast<int>(ids.size()) - (share == shares.end() ? 0 : share->second);
    if (other == owner || surplus <= beyond) continue;
    beyond = surplus;
    richest = &ids;
  }
  std::vector<std::uint32_t>& own = ids_.at(owner);
  if (const auto free = std::ranges::find(taken, false); free != taken.end()) {
    own.push_back(static_cast<std::uint32_t>(free - taken.begin()));
    return true;
  }
  if (richest == nullptr) return false;
  own.push_back(richest->back());
  richest->pop_back();
  return true;
}

}  // namespace splatbus::capture_bridge
