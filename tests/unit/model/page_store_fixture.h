#pragma once

#include <algorithm>
#include <cstring>
#include <map>
#include <memory>
#include <random>
#include <tuple>
#include <vector>

#include "device_test.h"

namespace splatbus::model {

using Where = std::map<std::uint64_t, std::uint32_t>;

/// A store, and the truth about what should be in it.
class PageStoreTest : public DeviceTest {
 protected:
  void start(std::size_t max_gaussians, const ParameterLayout& layout = {}) {
    start(max_gaussians, layout, GetParam());
  }
  void start(std::size_t max_gaussians, const ParameterLayout& layout, Device device) {
    store_.reset();
    context_ = connect("trainer");
    store_ = std::make_unique<PageStore>(context_, layout, PageStoreOptions{.max_gaussians = max_gaussians}, device);
  }

  [[nodiscard]] Where where() const {
    Where result;
    for (const auto& [id, place] : Found(*store_).by_id) result[id] = place.index;
    return result;
  }
  [[nodiscard]] std::vector<std::uint32_t> indices_of(const std::vector<std::uint64_t>& ids) const {
    const Where places = where();
    std::vector<std::uint32_t> result;
    for (const std::uint64_t id : ids) result.push_back(places.at(id));
    return result;
  }
  std::vector<std::uint64_t> some_ids(std::size_t count) {
    std::vector<std::uint64_t> ids, chosen;
    for (const auto& [id, gaussian] : truth_.gaussians) ids.push_back(id);
    std::sample(ids.begin(), ids.end(), std::back_inserter(chosen), count, random_);
    return chosen;
  }

  /// Everything that should be there is, once and whole, in the page of its key.
  void expect_sound() const {
    const Found found(*store_);
    expect_whole(found, truth_);
    ASSERT_EQ(store_->count(), truth_.gaussians.size());
    expect_in_place(found);
    expect_bounds(found);
  }

  void expect_in_place(const Found& found) const {
    using Key = std::tuple<std::uint32_t, std::uint64_t, std::uint64_t>;
    std::map<Key, std::uint32_t> pages;
    for (const IndexRange& range : store_->view().ranges) {
      const PageStructure& page = store_->table().entry(range.first / kPageLanes).now;
      ASSERT_TRUE(pages.emplace(Key{page.frame_id, page.morton_first, page.id_first}, range.first / kPageLanes).second);
    }
    for (const auto& [id, place] : found.by_id) {
      const std::vector<float>& values = place.gaussian.values;
      const float* const sample = values.data() + values.size() - 4;
      const auto after = pages.upper_bound({place.gaussian.frame_id, slow_key(sample), id});
      ASSERT_NE(after, pages.begin()) << "the first page of a frame takes everything";
      ASSERT_EQ(std::prev(after)->second, place.index / kPageLanes) << "Gaussian " << id;
    }
  }

  void expect_bounds(const Found& found) const {
    std::map<std::uint32_t, PageBounds> expected;
    for (const auto& [id, place] : found.by_id) {
      const std::vector<float>& v = place.gaussian.values;
      include(expected[place.index / kPageLanes], {v[0], v[1], v[2]}, std::max({v[3], v[4], v[5]}));
    }
    const GaussiansView view = store_->view();
    ASSERT_EQ(view.ranges.size(), expected.size());
    ASSERT_EQ(view.bounds.size(), expected.size());
    ASSERT_EQ(store_->page_count(), expected.size());
    const auto ranges = to_host(store_->device(), store_->device_ranges(), expected.size());
    const auto bounds = to_host(store_->device(), store_->device_bounds(), expected.size());
    std::size_t r = 0;
    for (const auto& [page, box] : expected) {
      const PageBounds& in_table = store_->table().entry(page).bounds;
      ASSERT_EQ(view.ranges[r].first, page * kPageLanes);
      ASSERT_EQ(view.ranges[r].count, store_->table().entry(page).now.count);
      ASSERT_EQ(view.ranges[r].frame_id, store_->table().entry(page).now.frame_id);
      ASSERT_EQ(std::memcmp(&ranges[r], &view.ranges[r], sizeof(IndexRange)), 0);
      for (const PageBounds* is : {&in_table, &view.bounds[r], &bounds[r]}) {
        ASSERT_EQ(std::tie(is->low.x, is->low.y, is->low.z), std::tie(box.low.x, box.low.y, box.low.z));
        ASSERT_EQ(std::tie(is->high.x, is->high.y, is->high.z), std::tie(box.high.x, box.high.y, box.high.z));
        ASSERT_NEAR(is->max_scale_m, box.max_scale_m, 1e-6F * box.max_scale_m);
      }
      ++r;
    }
  }

  std::mt19937 random_{11};
  Truth truth_;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<PageStore> store_;
};

}  // namespace splatbus::model
