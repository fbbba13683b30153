#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <unordered_map>
#include <vector>

#include "stream/stream_model.h"

namespace splatbus::streamer {

/// Whose each page of the model is, of replicas that encode: that one's for which it weighs most (bus/rendezvous.h),
/// but of kGroup pages with neighbouring numbers none has more than its share, so that a small model is shared as well
/// as a large one. One thread.
class PageDivision {
 public:
  static constexpr std::uint32_t kGroup = 12;  ///< 2, 3, 4 and 6 divide it

  /// Ascending, distinct. With none of them every page is nobody's.
  explicit PageDivision(std::vector<std::string> sources = {});

  [[nodiscard]] const std::vector<std::string>& sources() const { return sources_; }
  /// Empty: nobody's.
  [[nodiscard]] const std::string& owner_of(std::uint32_t page) const;

 private:
  using Owners = std::array<std::uint8_t, kGroup>;
  [[nodiscard]] Owners divide(std::uint32_t group) const;

  std::vector<std::string> sources_;
  std::vector<std::uint64_t> hashes_;
  mutable std::unordered_map<std::uint32_t, Owners> owners_;  ///< by group, as far as somebody has asked
  std::string nobody_;
};

/// The pages that one replica encodes in one tick.
struct EncodedPages {
  std::string own;
  PageDivision division;
  /// That it has encoded before: it goes on, whosever they are, until another one has them.
  std::shared_ptr<const std::vector<stream::OfferedPage>> kept;
  std::set<std::uint32_t> left;  ///< not these: others have them

  [[nodiscard]] bool contains(std::uint32_t page) const;
};

/// Of a view in pages the ranges of some of them. Lives as long as `view` is read.
struct PartOfModel {
  GaussiansView view;
  std::size_t all = 0, own = 0;  ///< Gaussians of either; of a view without pages, which is one's own, 0

  PartOfModel(const GaussiansView& whole, const EncodedPages& pages);
  PartOfModel(const PartOfModel&) = delete;
  PartOfModel& operator=(const PartOfModel&) = delete;

 private:
  std::vector<IndexRange> ranges_;
  std::vector<PageBounds> bounds_;
  std::vector<std::uint64_t> generations_;
};

}  // namespace splatbus::streamer
