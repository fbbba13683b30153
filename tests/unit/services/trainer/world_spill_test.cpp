#include <bit>
#include <cmath>
#include <set>

#include "../../model/device_test.h"
#include "../../model/truth.h"
#include "trainer/world_keeper.h"

namespace splatbus::trainer {
namespace {

using model::Found;
using model::Truth;

constexpr std::size_t kPages = 24;
constexpr float kFetch_m = 12;
/// Where no high bit of a Morton key changes along the street.
constexpr float kAside_m = 12;

/// A street along x: 40 heaps of samples, 10 m from one to the next.
class WorldSpillTest : public model::DeviceTest {
 protected:
  ~WorldSpillTest() override { keeper_.reset(); }

  void start(std::size_t disk_bytes = 0, float fetch_m = kFetch_m) {
    WorldParameters parameters{.folder = directory_.path() + "/world", .period_s = 0.01};
    parameters.device_bytes = parameters.host_bytes = kPages * 962560 + 1000;
    parameters.disk_bytes = disk_bytes;
    parameters.fetch_m = fetch_m;
    context_ = connect("trainer");
    const std::size_t most = WorldKeeper::most_pages(parameters, {}, GetParam(), 1);
    ASSERT_EQ(most, kPages);
    store_ = std::make_unique<model::PageStore>(
        context_, ParameterLayout{}, model::PageStoreOptions{.max_gaussians = 1000000, .max_pages = most + 64},
        GetParam());
    keeper_ = std::make_unique<WorldKeeper>(*store_, parameters);
  }
  /// A ceiling of as many Gaussians, and none of memory.
  void start_counted(std::size_t gaussians) {
    const WorldParameters parameters{
        .folder = directory_.path() + "/world", .period_s = 0.01, .max_gaussians = gaussians, .fetch_m = kFetch_m};
    context_ = connect("trainer");
    store_ = std::make_unique<model::PageStore>(context_, ParameterLayout{},
                                                model::PageStoreOptions{.max_gaussians = gaussians}, GetParam());
    keeper_ = std::make_unique<WorldKeeper>(*store_, parameters);
  }
  void end(bool with_slabs) {
    keeper_.reset();
    store_.reset();
    if (with_slabs) {
      for (const char* role : {"page-table", "pages-0"}) context_->drop_slab(role);
    }
    context_.reset();
  }

  static model::Batch heap(int number) {
    std::mt19937 random(static_cast<unsigned>(number));
    model::Batch batch = model::make_batch(random, 900, false, 1);
    std::uniform_real_distribution<float> near(-1, 1);
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::size_t k = 0; k < batch.count; ++k) {
        batch.mean[c * batch.count + k] =
            near(random) + (c == 0 ? 5.0F + 10.0F * static_cast<float>(number) : kAside_m);
      }
    }
    return batch;
  }

  void stand(float x) { keeper_->see({{x, kAside_m, kAside_m}}); }
  /// Goes on until the condition holds; the ceiling holds all the time.
  bool turn_until(const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      keeper_->turn();
      EXPECT_LE(store_->arena_bytes(), std::size_t{128} * 393216);
      return condition();
    });
  }
  [[nodiscard]] std::set<int> heaps_here() const {
    std::set<int> heaps;
    for (const auto& [id, place] : Found(*store_).by_id) {
      heaps.insert(static_cast<int>(std::floor(place.gaussian.values[0] / 10)));
    }
    return heaps;
  }
  [[nodiscard]] bool all_near(float x) const {
    const std::set<int> here = heaps_here();
    for (int heap = 0; heap < 40; ++heap) {
      if (std::abs(10.0F * static_cast<float>(heap) + 5 - x) < kFetch_m && !here.contains(heap)) return false;
    }
    return true;
  }
  void walk_out() {
    for (int h = 0; h < 40; ++h) {
      stand(10.0F * static_cast<float>(h) + 5);
      const model::Batch batch = heap(h);
      insert(*store_, batch, static_cast<std::uint64_t>(h) + 1);
      truth_.insert(batch, batch.count);
      ASSERT_TRUE(turn_until([&] { return store_->page_count() <= kPages - 1; }));
    }
  }
  [[nodiscard]] std::set<world::PageKey> pages_here() const {
    std::set<world::PageKey> keys;
    for (const IndexRange& range : store_->view().ranges) {
      const model::PageStructure& page = store_->table().entry(range.first / kPageLanes).now;
      keys.insert({page.frame_id, page.level, page.morton_first, page.id_first});
    }
    return keys;
  }
  /// Whether a trainer that begins with the folder would leave any of these pages there.
  [[nodiscard]] bool folder_lacks_any_here() const {
    const world::World folder{std::filesystem::path(directory_.path() + "/world")};
    const auto pages = folder.pages();
    const std::set<world::PageKey> here = pages_here();
    return std::any_of(here.begin(), here.end(), [&](const world::PageKey& key) {
      const auto page = pages.find(key);
      return page == pages.end() || page->second.mark == world::PageMark::Spilled;
    });
  }
  /// What is in memory and what the folder has besides, together: everybody, once, as he was.
  void expect_everybody() {
    std::map<std::uint64_t, model::Gaussian> all;
    const Found found(*store_);
    for (const auto& [id, place] : found.by_id) all[id] = place.gaussian;
    const std::set<world::PageKey> resident = pages_here();
    std::size_t spilled = 0;
    world::World folder{std::filesystem::path(directory_.path() + "/world")};
    for (const auto& [key, entry] : folder.pages()) {
      if (entry.mark != world::PageMark::Spilled || resident.contains(key)) continue;
      const auto page = folder.read(key);
      ASSERT_TRUE(page);
      for (std::uint32_t lane = 0; lane < page->count; ++lane) {
        std::uint64_t id = 0;
        std::memcpy(&id, page->words.data() + 89 * page->count + 2 * lane, sizeof(id));
        model::Gaussian gaussian{.frame_id = key.frame_id, .values = {}};
        for (std::uint32_t row = 0; row < 89; ++row) {
          gaussian.values.push_back(std::bit_cast<float>(page->words[row * page->count + lane]));
        }
        ASSERT_TRUE(all.emplace(id, gaussian).second) << "Gaussian " << id << " is in memory, too";
        ++spilled;
      }
    }
    EXPECT_EQ(keeper_->stats().spilled, spilled);
    ASSERT_EQ(all.size(), truth_.gaussians.size());
    EXPECT_TRUE(all == truth_.gaussians);
  }

  Truth truth_;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<model::PageStore> store_;
  std::unique_ptr<WorldKeeper> keeper_;
};

TEST_P(WorldSpillTest, AWalkOutAndBackStaysUnderTheCeilingAndLosesNobody) {
  start();
  walk_out();
  EXPECT_GT(keeper_->stats().spilled_pages, 10U);
  EXPECT_TRUE(all_near(395));
  EXPECT_FALSE(heaps_here().contains(0)) << "the farthest go first";
  expect_everybody();
  for (float x = 390; x >= 0; x -= 5) {
    stand(x);
    ASSERT_TRUE(turn_until([&] { return all_near(x) && store_->page_count() <= kPages; })) << x;
  }
  EXPECT_FALSE(heaps_here().contains(39));
  ASSERT_TRUE(turn_until([&] { return keeper_->stats().rounds > 3; }));
  end(false);  // what is here is written
  start();
  expect_everybody();
}

TEST_P(WorldSpillTest, AModelThatHasAllItsGaussiansInMemoryGivesPlaceToNewOnes) {
  constexpr std::size_t kMost = kPages * 900, kHigh = kMost - kMost / 16;
  start_counted(kMost);
  for (int h = 0; h < 40; ++h) {
    stand(10.0F * static_cast<float>(h) + 5);
    const model::Batch batch = heap(h);
    insert(*store_, batch, static_cast<std::uint64_t>(h) + 1);
    truth_.insert(batch, batch.count);
    ASSERT_TRUE(turn_until([&] { return store_->count() <= kHigh; })) << h;
  }
  EXPECT_GE(store_->count(), kMost / 2) << "more has left than had to";
  EXPECT_TRUE(all_near(395));
  expect_everybody();
  for (float x = 390; x >= 0; x -= 5) {
    stand(x);
    ASSERT_TRUE(turn_until([&] { return all_near(x) && store_->count() <= kMost; })) << x;
  }
  EXPECT_FALSE(heaps_here().contains(39));
  // A model that comes out of the folder leaves as much room, and one without viewers has no farthest page.
  end(true);
  start_counted(kMost);
  EXPECT_GT(store_->count(), kMost / 2);
  EXPECT_LE(store_->count(), kMost - kMost / 8);
  expect_everybody();
  int heaps = 0;
  for (; store_->count() <= kHigh; ++heaps) insert(*store_, heap(50 + heaps), static_cast<std::uint64_t>(50 + heaps));
  const std::size_t full = store_->count();
  // What leaves does so with the commit of the round that looked for it.
  ASSERT_TRUE(turn_until([&, rounds = keeper_->stats().rounds] { return keeper_->stats().rounds > rounds; }));
  EXPECT_EQ(store_->count(), full);
}

TEST_P(WorldSpillTest, WhatIsSpilledIsNotPutInTwice) {
  start();
  walk_out();
  ASSERT_FALSE(heaps_here().contains(3));
  // Once more what is there: samples of other ids at the same places.
  const std::size_t before = store_->count();
  const model::InsertResult result = insert(*store_, heap(3), 1000);
  EXPECT_GE(result.left_out, 890U);
  EXPECT_LE(store_->count(), before + 10);
  // And something that is new, though its keys lie between those of pages that are not here.
  model::Batch fresh = heap(3);
  for (std::size_t k = 0; k < fresh.count; ++k) fresh.mean[fresh.count + k] += 3.0F;
  EXPECT_EQ(insert(*store_, fresh, 1001).left_out, 0U);
}

TEST_P(WorldSpillTest, AnotherTrainerGoesOnWithBoth) {
  start();
  walk_out();
  end(true);
  start();
  EXPECT_LE(store_->page_count(), kPages);
  EXPECT_GT(keeper_->stats().spilled_pages, 10U);
  expect_everybody();
  stand(5);
  ASSERT_TRUE(turn_until([&] { return all_near(5); }));
}

TEST_P(WorldSpillTest, BeyondTheDiskTheFarthestIsForgottenAndSeenAnew) {
  constexpr std::size_t kDisk = 3'000'000;
  start(kDisk);
  walk_out();
  std::set<int> folder_has;
  ASSERT_TRUE(turn_until([&] {
    folder_has.clear();
    const world::World folder{std::filesystem::path(directory_.path() + "/world")};
    for (const auto& [key, entry] : folder.pages()) {
      folder_has.insert(static_cast<int>(std::floor(entry.bounds.low.x / 10)));
    }
    return folder.live_bytes() <= kDisk && !folder_has.contains(0) && folder_has.contains(39);
  }));
  EXPECT_EQ(insert(*store_, heap(0), 1000).left_out, 0U);
  // All values change, again and again: what no longer counts is compacted in time.
  for (int again = 0; again < 8; ++again) {
    store_->add_step(1, 0.1);
    const std::uint64_t pages = keeper_->stats().pages;
    ASSERT_TRUE(turn_until([&] {
      EXPECT_LE(keeper_->stats().disk_bytes, kDisk);
      return keeper_->stats().pages >= pages + 10;
    }));
  }
}

/// What is on its way to the disk may change meanwhile: it leaves another time, as it is then.
TEST_P(WorldSpillTest, WhatChangesWhileItIsWrittenStaysUntilTheFolderHasItAsItIs) {
  start();
  for (int h = 0; store_->page_count() < kPages; ++h) {
    ASSERT_LT(h, 40);
    stand(10.0F * static_cast<float>(h) + 5);
    const model::Batch batch = heap(h);
    insert(*store_, batch, static_cast<std::uint64_t>(h) + 1);
    truth_.insert(batch, batch.count);
  }
  keeper_->turn();  // all pages are on their way, and the farthest are to leave
  std::vector<std::uint64_t> ids;
  std::vector<std::uint32_t> indices;
  std::set<std::uint32_t> changed;
  for (const auto& [id, place] : Found(*store_).by_id) {
    if (!changed.insert(place.index / kPageLanes).second) continue;
    ids.push_back(id);
    indices.push_back(place.index);
  }
  model::remove(*store_, indices);
  truth_.remove(ids);
  ASSERT_EQ(keeper_->stats().rounds, 0U);
  ASSERT_TRUE(turn_until([&] { return keeper_->stats().rounds > 0; }));
  expect_everybody();
  ASSERT_TRUE(turn_until([&] { return keeper_->stats().spilled_pages > 0; }));
  expect_everybody();
}

TEST_P(WorldSpillTest, WhatWasOnDiskAloneStaysThereAtAStartThoughThereIsRoom) {
  start();
  walk_out();
  std::vector<std::uint64_t> ids;
  std::vector<std::uint32_t> indices;
  for (const auto& [id, place] : Found(*store_).by_id) {
    if (place.gaussian.values[0] > 360) continue;
    ids.push_back(id);
    indices.push_back(place.index);
  }
  model::remove(*store_, indices);
  truth_.remove(ids);
  const std::set<world::PageKey> here = pages_here();
  const std::uint64_t spilled = keeper_->stats().spilled_pages;
  ASSERT_LT(here.size(), kPages / 2);
  ASSERT_GT(spilled, 10U);
  end(true);
  start();
  EXPECT_EQ(pages_here(), here);
  EXPECT_EQ(keeper_->stats().spilled_pages, spilled);
  expect_everybody();
}

/// With more to come back than there is room for, what is near takes the place of what is far.
TEST_P(WorldSpillTest, ThereIsRoomForWhatIsNearWhereAllIsToComeBack) {
  start(0, 1000);
  walk_out();
  EXPECT_FALSE(heaps_here().contains(0));
  stand(5);
  // What is far leaves in turns of its own.
  ASSERT_TRUE(turn_until([&] { return all_near(5) && !heaps_here().contains(39); }));
  expect_everybody();
}

/// What rests has no moments: more of it has room, and as much as the ceiling says.
TEST_P(WorldSpillTest, WhatRestsTakesLessOfTheCeiling) {
  start();
  int heaps = 0;
  while (keeper_->stats().spilled_pages == 0) {
    ASSERT_LT(heaps, 40);
    stand(10.0F * static_cast<float>(heaps) + 5);
    const model::Batch batch = heap(heaps);
    insert(*store_, batch, static_cast<std::uint64_t>(++heaps));
    truth_.insert(batch, batch.count);
    std::vector<std::uint32_t> pages;
    for (const IndexRange& range : store_->view().ranges) pages.push_back(range.first / kPageLanes);
    store_->freeze(pages);
    const std::uint64_t rounds = keeper_->stats().rounds;
    ASSERT_TRUE(turn_until([&] { return keeper_->stats().rounds > rounds; }));
  }
  EXPECT_GT(store_->page_count() + keeper_->stats().spilled_pages, kPages);
  EXPECT_LE(store_->page_count() * 626688, kPages * 962560);
  EXPECT_EQ(heaps_here().contains(0), false) << "the farthest goes first";
}

/// What rests is in the folder as it is: it leaves for what is wanted back, and comes back, without being written once
/// more.
TEST_P(WorldSpillTest, WhatRestsLeavesAndComesBackWithoutBeingWritten) {
  start();
  for (int heaps = 0; keeper_->stats().spilled_pages < 4;) {
    ASSERT_LT(heaps, 40);
    stand(10.0F * static_cast<float>(heaps) + 5);
    const model::Batch batch = heap(heaps);
    insert(*store_, batch, static_cast<std::uint64_t>(++heaps));
    truth_.insert(batch, batch.count);
    std::vector<std::uint32_t> pages;
    for (const IndexRange& range : store_->view().ranges) pages.push_back(range.first / kPageLanes);
    store_->freeze(pages);
    const std::uint64_t rounds = keeper_->stats().rounds;
    ASSERT_TRUE(turn_until([&] { return keeper_->stats().rounds > rounds; }));
  }
  const std::set<int> here = heaps_here();
  const std::uint64_t written = keeper_->stats().pages;
  stand(5);
  ASSERT_TRUE(turn_until([&] { return all_near(5) && !heaps_here().contains(*here.rbegin()); }));
  ASSERT_TRUE(turn_until([&] { return !folder_lacks_any_here(); })) << "it is nowhere else, the folder says";
  EXPECT_EQ(keeper_->stats().pages, written);
  expect_everybody();
  end(true);
  start();
  EXPECT_TRUE(all_near(5)) << "older than the others, and yet first";
  EXPECT_GT(store_->page_count(), kPages / 2) << "at the end nothing leaves for what does not come back";
  expect_everybody();
}

INSTANTIATE_TEST_SUITE_P(Devices, WorldSpillTest, testing::Values(Device::Cpu, Device::Cuda), model::device_name);

}  // namespace
}  // namespace splatbus::trainer
