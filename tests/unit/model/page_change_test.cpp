// Insertion, duplication, removal and merging: who moves where, and that everybody stays whole.
#include "page_store_fixture.h"

namespace splatbus::model {

namespace {

class PageChangeTest : public PageStoreTest {
 protected:
  /// Whoever was there and is there still is where it was, or where the moves say.
  void expect_moves(const Where& before, const Moves& moves) const {
    const auto from = to_host(store_->device(), moves.from, moves.count);
    const auto to = to_host(store_->device(), moves.to, moves.count);
    std::map<std::uint32_t, std::uint32_t> moved;
    for (std::size_t k = 0; k < moves.count; ++k) ASSERT_TRUE(moved.emplace(from[k], to[k]).second);
    for (const std::uint32_t index : to) ASSERT_FALSE(moved.contains(index)) << "targets are no sources";
    for (const auto& [id, index] : where()) {
      const auto was = before.find(id);
      if (was == before.end()) continue;
      const auto move = moved.find(was->second);
      ASSERT_EQ(index, move == moved.end() ? was->second : move->second) << "Gaussian " << id;
    }
  }

  void expect_added(std::uint64_t first_id, const InsertResult& result) const {
    const auto added = to_host(store_->device(), result.added, result.count);
    const Where places = where();
    for (std::size_t k = 0; k < added.size(); ++k) ASSERT_EQ(added[k], places.at(first_id + k));
  }

  /// What a change wrote is no more than the pages that it touched.
  template <class Change>
  auto within_touched(Change&& change) {
    std::vector<std::uint64_t> before;
    for (std::uint32_t page = 0; page < store_->table().page_capacity(); ++page) {
      before.push_back(store_->table().entry(page).generation);
    }
    const std::uint64_t written = store_->written_bytes();
    const auto result = change();
    std::size_t touched = 0;
    for (std::uint32_t page = 0; page < before.size(); ++page) {
      touched += store_->table().entry(page).generation != before[page] ? 1 : 0;
    }
    EXPECT_LE(store_->written_bytes() - written, touched * page_bytes(store_->layout()));
    return result;
  }

  void churn(std::size_t rounds, std::size_t most, std::size_t max_gaussians) {
    start(max_gaussians);
    for (std::size_t round = 0; round < rounds; ++round) {
      SCOPED_TRACE("round " + std::to_string(round));
      const Where before = where();
      const auto dice = random_() % 10;
      const bool crowded = truth_.gaussians.size() > max_gaussians * 3 / 4;
      if (crowded || dice < 3) {
        const std::size_t share = crowded ? 2 : 5;
        const auto ids = some_ids(random_() % (truth_.gaussians.size() / share + 2));
        const auto indices = indices_of(ids);
        const RemoveResult result = within_touched([&] { return remove(*store_, indices); });
        EXPECT_EQ(result.removed, ids.size());
        truth_.remove(ids);
        expect_moves(before, result.moves);
        if (random_() % 4 == 0) {
          const Where removed = where();
          expect_moves(removed, within_touched([&] { return store_->merge(); }));
        }
      } else if (dice < 5) {
        const auto ids = some_ids(random_() % (truth_.gaussians.size() / 20 + 2));
        const auto indices = indices_of(ids);
        const InsertResult result = within_touched([&] { return duplicate(*store_, indices); });
        EXPECT_EQ(result.count, ids.size());
        expect_moves(before, result.moves);
        expect_added(truth_.next_id, result);
        truth_.duplicate(ids);
      } else {
        const std::size_t count = 1 + random_() % (round % 7 == 0 ? most : most / 20);
        const Batch batch = make_batch(random_, count, random_() % 2 == 0, 4);
        const InsertResult result = within_touched([&] { return insert(*store_, batch, round); });
        EXPECT_EQ(result.left_out, 0U);
        expect_moves(before, result.moves);
        expect_added(truth_.next_id, result);
        truth_.insert(batch, result.count);
      }
      expect_sound();
      if (HasFatalFailure() || HasNonfatalFailure()) return;
    }
  }
};

TEST_P(PageChangeTest, ThroughHundredsOfChangesEachGaussianStaysWholeAndInItsPage) {
  churn(200, 6000, 8000);
}

TEST_P(PageChangeTest, ThroughLargeChangesToo) {
  churn(8, 60000, 90000);
}

TEST_P(PageChangeTest, MoreOfOneKeyThanAPageHoldsAreSpreadByTheirIds) {
  start(20000);
  Batch batch = make_batch(random_, 700, false, 1);
  std::fill(batch.mean.begin(), batch.mean.end(), 1.5F);
  for (std::uint64_t round = 0; round < 8; ++round) {
    insert(*store_, batch, round);
    truth_.insert(batch, batch.count);
    expect_sound();
  }
  EXPECT_GT(store_->page_count(), 5U);
}

TEST_P(PageChangeTest, PagesThatRemovalsLeftSparseAreMerged) {
  start(60000);
  const Batch batch = make_batch(random_, 40000, false, 3);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  EXPECT_EQ(store_->merge().count, 0U) << "what a split leaves is not sparse";
  const std::size_t pages = store_->page_count();
  const auto ids = some_ids(38000);
  remove(*store_, indices_of(ids));
  truth_.remove(ids);
  EXPECT_EQ(store_->page_count(), pages);
  const Where before = where();
  expect_moves(before, store_->merge());
  EXPECT_LE(store_->page_count(), 2U * (2000 / (kPageLanes * 3 / 4)) + 3);
  expect_sound();
  start(60000);
  expect_sound();
}

TEST_P(PageChangeTest, APageThatRestsIsMergedWithNoOther) {
  start(60000);
  const Batch batch = make_batch(random_, 20000, false, 1);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  const auto ids = some_ids(19000);
  remove(*store_, indices_of(ids));
  truth_.remove(ids);
  // All are sparse. Along the curve every third rests, so that each has one that trains before it and one behind.
  std::map<std::pair<std::uint64_t, std::uint64_t>, std::uint32_t> along;
  for (const IndexRange& range : store_->view().ranges) {
    const PageStructure& page = store_->table().entry(range.first / kPageLanes).now;
    along[{page.morton_first, page.id_first}] = range.first / kPageLanes;
  }
  std::vector<std::uint32_t> resting;
  std::size_t k = 0;
  for (const auto& [key, page] : along) {
    if (k++ % 3 == 1) resting.push_back(page);
  }
  ASSERT_GT(resting.size(), 5U);
  store_->freeze(resting);
  const std::size_t pages = store_->page_count();
  Where of_resting;
  for (const auto& [id, index] : where()) {
    if (std::count(resting.begin(), resting.end(), index / kPageLanes) > 0) of_resting[id] = index;
  }
  store_->merge();
  EXPECT_LT(store_->page_count(), pages) << "those that train were";
  Where there;
  for (const auto& [id, index] : where()) {
    if (std::count(resting.begin(), resting.end(), index / kPageLanes) > 0) there[id] = index;
  }
  EXPECT_EQ(there, of_resting);
}

TEST_P(PageChangeTest, WhereTheFirstPageOfAFrameIsGoneTheNextTakesWhatComesBeforeIt) {
  start(60000);
  for (std::uint64_t round = 0; round < 2; ++round) {
    const Batch batch = make_batch(random_, 8000, false, 2);
    insert(*store_, batch, round);
    truth_.insert(batch, batch.count);
    std::vector<std::uint64_t> ids;
    for (const auto& [id, place] : Found(*store_).by_id) {
      const PageStructure& page = store_->table().entry(place.index / kPageLanes).now;
      if (page.morton_first == 0 && page.id_first == 0) ids.push_back(id);
    }
    EXPECT_GT(ids.size(), 500U);
    remove(*store_, indices_of(ids));
    truth_.remove(ids);
  }
  const Batch batch = make_batch(random_, 8000, false, 2);
  insert(*store_, batch, 2);
  truth_.insert(batch, batch.count);
  expect_sound();
}

INSTANTIATE_TEST_SUITE_P(Devices, PageChangeTest, testing::Values(Device::Cpu, Device::Cuda), device_name);

}  // namespace

}  // namespace splatbus::model
