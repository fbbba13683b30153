#include "streamer/page_division.h"

#include <gtest/gtest.h>

#include <map>
#include <set>

namespace splatbus::streamer {
namespace {

constexpr std::uint32_t kPages = 3000;

std::map<std::string, std::set<std::uint32_t>> pages_of(const std::vector<std::string>& sources) {
  const PageDivision division(sources);
  std::map<std::string, std::set<std::uint32_t>> pages;
  for (std::uint32_t page = 0; page < kPages; ++page) pages[division.owner_of(page)].insert(page);
  return pages;
}

TEST(PageDivision, ASmallModelIsSharedAsEvenlyAsALargeOne) {
  const std::vector<std::string> all{"streamer-1", "streamer-2", "streamer-3", "streamer-4"};
  for (std::size_t replicas = 1; replicas <= all.size(); ++replicas) {
    const PageDivision division({all.begin(), all.begin() + static_cast<std::ptrdiff_t>(replicas)});
    for (std::uint32_t first = 0; first < kPages; first += PageDivision::kGroup) {
      std::map<std::string, std::size_t> count;
      for (std::uint32_t k = 0; k < PageDivision::kGroup; ++k) ++count[division.owner_of(first + k)];
      ASSERT_EQ(count.size(), replicas);
      for (const auto& [source, pages] : count) EXPECT_EQ(pages, PageDivision::kGroup / replicas) << source;
    }
  }
}

TEST(PageDivision, WhatRemainsOfTwoKeepsItsOwn) {
  const auto both = pages_of({"streamer-1", "streamer-2"});
  for (const std::string own : {"streamer-1", "streamer-2"}) {
    const auto alone = pages_of({own});
    EXPECT_EQ(alone.at(own).size(), kPages);
    EXPECT_EQ(both.at(own).size(), kPages / 2);
  }
}

TEST(PageDivision, OneThatComesTakesLittleMoreThanItsShare) {
  const auto before = pages_of({"streamer-1", "streamer-2"});
  const auto after = pages_of({"streamer-1", "streamer-2", "streamer-3"});
  std::size_t moved = 0;
  for (const auto& [source, pages] : after) {
    if (!before.contains(source)) continue;
    for (const std::uint32_t page : pages) moved += before.at(source).contains(page) ? 0 : 1;
  }
  EXPECT_EQ(after.at("streamer-3").size(), kPages / 3);
  EXPECT_LT(moved, kPages / 10) << "between those that were there";
}

TEST(PageDivision, WithoutReplicasNobodyHasAPage) {
  EXPECT_EQ(PageDivision().owner_of(5), "");
  const EncodedPages pages{.own = "streamer-1", .division = PageDivision(), .kept = {}, .left = {}};
  EXPECT_FALSE(pages.contains(5));
}

/// Of pages 0 to 11, those that "b" has of "a" and "b".
class Encoded : public testing::Test {
 protected:
  Encoded() {
    pages_.own = "b";
    pages_.division = PageDivision({"a", "b"});
    for (std::uint32_t page = 0; page < 12; ++page) {
      (pages_.division.owner_of(page) == "b" ? own_ : other_).push_back(page);
    }
  }
  EncodedPages pages_;
  std::vector<std::uint32_t> own_, other_;
};

TEST_F(Encoded, WhatWasEncodedBeforeIsKeptUntilAnotherOneHasIt) {
  ASSERT_EQ(own_.size(), 6U);
  EXPECT_TRUE(pages_.contains(own_[0]));
  EXPECT_FALSE(pages_.contains(other_[0]));
  pages_.kept = std::make_shared<std::vector<stream::OfferedPage>>(
      std::vector<stream::OfferedPage>{{.page = other_[0]}, {.page = other_[1]}});
  EXPECT_TRUE(pages_.contains(other_[0]));
  EXPECT_FALSE(pages_.contains(other_[2]));
  pages_.left = {other_[0]};
  EXPECT_FALSE(pages_.contains(other_[0]));
  EXPECT_TRUE(pages_.contains(other_[1]));
}

TEST_F(Encoded, APartOfAModelHasTheirRangesWithAllThatIsSaidOfThem) {
  std::vector<IndexRange> ranges;
  std::vector<PageBounds> bounds;
  std::vector<std::uint64_t> generations;
  for (std::uint32_t page = 0; page < 12; ++page) {
    ranges.push_back({.first = page * kPageLanes, .count = 10 + page});
    bounds.push_back({.low = {}, .high = {}, .max_scale_m = static_cast<float>(page)});
    generations.push_back(100 + page);
  }
  GaussiansView whole;
  whole.page_shift = kPageShift;
  whole.ranges = ranges;
  whole.bounds = bounds;
  whole.generations = generations;
  const PartOfModel part(whole, pages_);
  ASSERT_EQ(part.view.ranges.size(), own_.size());
  ASSERT_EQ(part.view.bounds.size(), own_.size());
  ASSERT_EQ(part.view.generations.size(), own_.size());
  std::size_t own = 0;
  for (std::size_t k = 0; k < own_.size(); ++k) {
    EXPECT_EQ(part.view.ranges[k], ranges[own_[k]]);
    EXPECT_EQ(part.view.bounds[k].max_scale_m, static_cast<float>(own_[k]));
    EXPECT_EQ(part.view.generations[k], 100 + own_[k]);
    own += 10 + own_[k];
  }
  EXPECT_EQ(part.own, own);
  EXPECT_EQ(part.all, std::size_t{12 * 10 + 66});
}

}  // namespace
}  // namespace splatbus::streamer
