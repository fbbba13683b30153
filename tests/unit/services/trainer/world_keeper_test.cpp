#include "trainer/world_keeper.h"

#include <sys/resource.h>

#include <filesystem>
#include <fstream>
#include <optional>

#include "../../bus/child_process.h"
#include "../../model/device_test.h"
#include "kept_script.h"

namespace splatbus::trainer {
namespace {

using model::Found;
using model::Truth;

class WorldKeeperTest : public model::DeviceTest {
 protected:
  ~WorldKeeperTest() override { keeper_.reset(); }

  [[nodiscard]] std::string folder() const { return directory_.path() + "/world"; }

  void start(const WorldParameters& parameters = {}, std::size_t max_gaussians = kKeptGaussians) {
    start_store(max_gaussians);
    start_keeper(parameters);
  }
  void start_store(std::size_t max_gaussians = kKeptGaussians) {
    context_ = connect("trainer");
    store_ = std::make_unique<model::PageStore>(context_, ParameterLayout{},
                                                model::PageStoreOptions{.max_gaussians = max_gaussians}, GetParam());
  }
  void start_keeper(const WorldParameters& parameters = {}) {
    WorldParameters with = parameters;
    with.folder = folder();
    with.period_s = 0.01;
    keeper_ = std::make_unique<WorldKeeper>(*store_, with);
  }
  /// With all that the bus knows of the model.
  void drop_slabs() {
    for (const char* role : {"page-table", "pages-0", "pages-1"}) context_->drop_slab(role);
  }
  void end(bool with_slabs) {
    keeper_.reset();
    store_.reset();
    if (with_slabs) drop_slabs();
    context_.reset();
  }
  void change(std::size_t count) {
    for (std::size_t c = 0; c < count; ++c) change_model(changes_++, store_.get(), truth_);
  }
  void set_parameter(std::uint32_t index, float value) const {
    const device::Stream stream(store_->device());
    device::copy(stream, store_->parameters() + view_offset(index), &value, sizeof(value));
    stream.wait();
  }
  [[nodiscard]] std::size_t view_offset(std::uint32_t index) const { return store_->view().offset(index); }

  Truth truth_;
  std::size_t changes_ = 0;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<model::PageStore> store_;
  std::unique_ptr<WorldKeeper> keeper_;
};

TEST_P(WorldKeeperTest, AnEmptyStoreGetsWhatTheFolderHolds) {
  start();
  change(12);
  const std::uint32_t settled = store_->view().ranges[1].first / kPageLanes;
  const std::uint32_t unseen = store_->view().ranges[0].first / kPageLanes;
  store_->table().entry(settled).loss = 0.1F;
  store_->table().entry(unseen).loss = 0;
  store_->freeze(std::vector{settled, unseen});
  ASSERT_EQ(store_->frozen_pages(), 2U);
  for (int s = 0; s < 7; ++s) store_->add_step(2, 0.25);
  truth_.gaussians.clear();
  for (const auto& [id, place] : Found(*store_).by_id) truth_.gaussians[id] = place.gaussian;
  const std::uint64_t next_id = store_->next_gaussian_id();
  end(true);
  start();
  expect_whole(Found(*store_), truth_);
  EXPECT_EQ(store_->next_gaussian_id(), next_id);
  EXPECT_EQ(store_->step(), 7U);
  EXPECT_EQ(store_->views(), 14U);
  EXPECT_EQ(store_->frozen_pages(), 1U) << "what no view has shown goes on";
  // Nothing has changed since: nothing is written.
  end(true);
  start();
  ASSERT_TRUE(bus_test::eventually([&] {
    keeper_->turn();
    return keeper_->stats().rounds == 0;
  }));
  change(5);
  expect_whole(Found(*store_), truth_);
}

TEST_P(WorldKeeperTest, ALivingModelStandsAndTheFolderFollowsIt) {
  start();
  change(8);
  end(false);  // kept, and still on the bus
  {
    // It lives on without the folder.
    context_ = connect("trainer");
    store_ = std::make_unique<model::PageStore>(context_, ParameterLayout{},
                                                model::PageStoreOptions{.max_gaussians = kKeptGaussians}, GetParam());
    change(9);
    store_.reset();
  }
  start();
  expect_whole(Found(*store_), truth_);
  end(true);
  start();
  expect_whole(Found(*store_), truth_);
}

/// Pages whose values have changed come to the folder one after the other, those that were kept longest ago first, and
/// no more of them than bytes a second allow.
TEST_P(WorldKeeperTest, ValuesFollowWithinTheirBytesASecond) {
  start({.bytes_per_s = 100U << 20U, .staging_bytes = 1U << 20U});
  change(11);
  ASSERT_GT(store_->page_count(), 4U);
  std::map<std::uint64_t, float> expected;
  for (const auto& [id, place] : Found(*store_).by_id) {
    expected[id] = static_cast<float>(id) * 0.5F;
    set_parameter(place.index, expected[id]);
  }
  store_->add_step(1, 0.1);
  ASSERT_TRUE(bus_test::eventually([&] {
    keeper_->turn();
    const world::World reader{folder()};
    const auto pages = reader.pages();
    return pages.size() == store_->page_count() &&
           std::all_of(pages.begin(), pages.end(), [](const auto& entry) { return entry.second.step == 1; });
  }));
  const std::uint64_t rounds = keeper_->stats().rounds;
  EXPECT_GE(rounds, store_->page_count() / 2) << "two pages are what there is memory for";
  end(true);
  start();
  for (const auto& [id, place] : Found(*store_).by_id) ASSERT_EQ(place.gaussian.values[0], expected.at(id));
}

TEST_P(WorldKeeperTest, WhatIsKeptStaysWhereThereIsNoRoomForIt) {
  start();
  change(7);
  const std::size_t all = store_->count();
  end(true);
  start({}, 1500);
  EXPECT_LE(store_->count(), 1500U);
  EXPECT_GT(store_->count(), 0U);
  end(true);
  start();
  EXPECT_EQ(store_->count(), all);
  expect_whole(Found(*store_), truth_);
}

TEST_P(WorldKeeperTest, ADiskThatRefusesStopsNobody) {
  start();
  change(3);
  ::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  const rlimit none{.rlim_cur = 2048, .rlim_max = before.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &none);
  ASSERT_TRUE(bus_test::eventually([&] {
    keeper_->turn();
    return keeper_->stats().refused_rounds > 0;
  }));
  EXPECT_EQ(keeper_->stats().rounds, 0U);
  ::setrlimit(RLIMIT_FSIZE, &before);
  ASSERT_TRUE(bus_test::eventually([&] {
    keeper_->turn();
    return keeper_->stats().rounds > 0;
  }));
  end(true);
  start();
  expect_whole(Found(*store_), truth_);
}

TEST_P(WorldKeeperTest, ADiskThatIsFullAtTheStartStopsNobody) {
  start_store();
  ::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  const rlimit none{.rlim_cur = 0, .rlim_max = before.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &none);
  start_keeper();
  EXPECT_EQ(keeper_->stats().refused_rounds, 1U);
  ::setrlimit(RLIMIT_FSIZE, &before);
  change(3);
  ASSERT_TRUE(bus_test::eventually([&] {
    keeper_->turn();
    return keeper_->stats().rounds > 0;
  }));
  expect_whole(Found(*store_), truth_);
  end(true);
  start();
  expect_whole(Found(*store_), truth_);
}

/// A Gaussian that damage has left in two pages is there once, as it was last.
TEST_P(WorldKeeperTest, NobodyIsThereTwice) {
  start();
  change(1);
  const std::size_t count = store_->count(), pages = store_->page_count();
  end(true);
  {
    world::World world(folder(), {});
    auto page = *world.read(world.pages().begin()->first);
    page.key.id += 1;
    page.words[0] = std::bit_cast<std::uint32_t>(77.0F);
    world.put(page, world::encode_page(page, world.layout()));
    world.commit(world.progress());
  }
  start();
  EXPECT_EQ(store_->count(), count);
  const Found found(*store_);
  EXPECT_EQ(std::count_if(found.by_id.begin(), found.by_id.end(),
                          [](const auto& entry) { return entry.second.gaussian.values[0] == 77.0F; }),
            1);
  end(true);
  EXPECT_EQ(world::World(folder()).pages().size(), pages) << "of no use";
}

/// Wherever it is killed, the folder has the model as it was at one instant, all of it, and not long ago.
TEST_P(WorldKeeperTest, WhateverMomentItIsKilledTheModelIsWhole) {
  if (GetParam() != Device::Cpu) GTEST_SKIP() << "as on the CPU";
  std::mt19937 random(6);
  const std::string output = directory_.path() + "/output";
  for (int kill = 0; kill < 8; ++kill) {
    std::filesystem::remove_all(folder());
    std::filesystem::remove(output);
    bus_test::ChildProcess child("test-trainer-kept", {directory_.path(), folder()}, output);
    const std::size_t enough = 10 + random() % 50;
    const auto told = [&] {
      std::vector<std::int64_t> when;
      std::ifstream lines(output);
      std::size_t change = 0;
      long long at = 0;
      for (std::string line; std::getline(lines, line);) {  // among what is logged
        if (std::sscanf(line.c_str(), "%zu %lld", &change, &at) == 2) when.push_back(at);
      }
      return when;
    };
    ASSERT_TRUE(bus_test::eventually([&] { return told().size() >= enough; })) << bus_test::read_text(output);
    ::usleep(random() % 20000);  // anywhere in a change
    child.send(SIGKILL);
    child.wait();
    const std::int64_t died_ns = bus::now_ns();
    const std::vector<std::int64_t> when = told();
    context_ = connect("trainer");
    drop_slabs();
    start();
    const Found found(*store_);
    Truth truth;
    std::optional<std::size_t> made;  // changes
    for (std::size_t change = 0; change <= when.size() + 1 && !made; ++change) {
      if (change > 0) change_model(change - 1, nullptr, truth);
      if (truth.gaussians.size() != found.by_id.size() || truth.next_id != store_->next_gaussian_id()) continue;
      const bool same = std::equal(truth.gaussians.begin(), truth.gaussians.end(), found.by_id.begin(),
                                   [](const auto& a, const auto& b) { return a.first == b.first; });
      if (same) made = change;
    }
    ASSERT_TRUE(made) << "the model as it never was, after " << when.size() << " changes";
    expect_whole(found, truth);
    if (*made < when.size()) {
      EXPECT_LT(died_ns - when[*made], 2'000'000'000) << "lost";
    }
    end(true);
    if (HasFailure()) return;
  }
}

/// A page that begins to rest, or to train again, has the Gaussians that the folder has: no commit waits for it.
TEST_P(WorldKeeperTest, PagesThatBeginToRestHoldNobodyUp) {
  start({.bytes_per_s = 1000, .staging_bytes = 1});  // a page a round, and none that may wait but at the end
  change(30);
  ASSERT_GT(store_->page_count(), 4U);
  const auto turn_until_kept = [&] {
    return bus_test::eventually([&] {
      keeper_->turn();
      return world::World(folder()).progress().generation == store_->generation();
    });
  };
  ASSERT_TRUE(turn_until_kept());
  std::uint64_t number = 1000;
  for (const bool rest : {true, false, true}) {
    std::vector<std::uint32_t> all;
    for (const IndexRange& range : store_->view().ranges) all.push_back(range.first / kPageLanes);
    for (const std::uint32_t page : all) store_->table().entry(page).loss = 0.1F;
    rest ? store_->freeze(all) : store_->thaw(all);
    std::mt19937 random(5);
    insert(*store_, model::make_batch(random, 1, true, 1), ++number);
    const std::uint64_t written = keeper_->stats().pages;
    ASSERT_TRUE(turn_until_kept());
    EXPECT_LE(keeper_->stats().pages, written + 2) << "those of the new one";
    std::size_t count = 0;
    for (const auto& [key, entry] : world::World(folder()).pages()) count += entry.count;
    EXPECT_EQ(count, store_->count());
  }
  truth_.gaussians.clear();
  for (const auto& [id, place] : Found(*store_).by_id) truth_.gaussians[id] = place.gaussian;
  const std::size_t frozen = store_->frozen_pages();
  end(true);
  start();
  expect_whole(Found(*store_), truth_);
  EXPECT_EQ(store_->frozen_pages(), frozen) << "it was written in the end";
}

TEST_P(WorldKeeperTest, PagesThatChangeFasterThanRoundsTakeThemAreKeptAllTheSame) {
  start({.staging_bytes = 1});  // a page a round
  change(30);
  ASSERT_GT(store_->page_count(), 3U);
  const std::uint64_t before = keeper_->stats().rounds;
  // All of them change with every turn, the structure of each.
  ASSERT_TRUE(bus_test::eventually([&] {
    std::vector<std::uint32_t> first_of_each;
    for (const IndexRange& range : store_->view().ranges) first_of_each.push_back(range.first);
    remove(*store_, first_of_each);
    keeper_->turn();
    const world::World reader(folder());
    return reader.pages().size() == store_->page_count();
  }));
  EXPECT_GT(keeper_->stats().rounds, before);
}

INSTANTIATE_TEST_SUITE_P(Devices, WorldKeeperTest, testing::Values(Device::Cpu, Device::Cuda), model::device_name);

}  // namespace
}  // namespace splatbus::trainer
