#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace splatbus::wire {
struct Liveness;
}  // namespace splatbus::wire

namespace splatbus::relight {

/// Which pages of the model are this replica's: each page is that of the live replica with the largest hash of page and
/// name (rendezvous hashing, Thaler and Ravishankar 1998), so that all who see the same replicas agree without a word,
/// and one that comes or goes moves no page between the others. One thread.
class PageShares {
 public:
  explicit PageShares(std::string own) : own_(std::move(own)), sources_{own_} {}

  /// The replicas are those of kind "relight" that run, as the broker sees it, and this one. True when they are others
  /// than before.
  bool take(const wire::Liveness& liveness);
  /// Whether the broker has been heard at all.
  [[nodiscard]] bool heard() const { return heard_; }

  [[nodiscard]] bool alone() const { return sources_.size() == 1; }
  [[nodiscard]] bool owns(std::uint32_t page) const;
  /// Ascending.
  [[nodiscard]] const std::vector<std::string>& sources() const { return sources_; }
  [[nodiscard]] std::uint32_t part() const;
  /// A hash of all their names.
  [[nodiscard]] std::uint64_t division() const;

  static constexpr std::size_t kMaxReplicas = 64;

 private:
  std::string own_;
  std::vector<std::string> sources_;
  bool heard_ = false;
};

}  // namespace splatbus::relight
