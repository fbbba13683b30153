#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

namespace splatbus::capture_bridge {

/// How many of `total` cameras each of those who need them gets: `least` to each, or to as many as there are enough
/// for, the neediest first, and what is left by need. Of equal need, whoever stands first. The sum is `total`, unless
/// nobody needs any.
[[nodiscard]] std::vector<int> divide_cameras(int total, std::span<const float> needs, int least);

/// Who has which of a role's camera ids 0, 1, ...; an id has one owner at most. Not thread-safe.
class CameraShares {
 public:
  using Shares = std::map<std::string, int>;  ///< by owner

  /// There are ids below `total` from now on.
  void set_total(int total);
  /// Ids of an owner, the ones that it keeps longest first; empty for one that has none.
  [[nodiscard]] std::span<const std::uint32_t> of(const std::string& owner) const;
  [[nodiscard]] const std::map<std::string, std::vector<std::uint32_t>>& all() const { return ids_; }
  /// The owner gets its share, if it has less: takes ids that are free, then those that others have beyond theirs. Who
  /// has more keeps it until somebody does so. An owner that is not in `shares` has a share of 0.
  void take_share(const std::string& owner, const Shares& shares);
  void release(const std::string& owner) { ids_.erase(owner); }

 private:
  [[nodiscard]] bool take_one(const std::string& owner, const Shares& shares);

  int total_ = 0;
  std::map<std::string, std::vector<std::uint32_t>> ids_;
};

}  // namespace splatbus::capture_bridge
