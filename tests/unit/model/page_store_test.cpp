#include <gmock/gmock.h>

#include <algorithm>

#include "../bus/bus_fixture.h"
#include "truth.h"
#include "wire/model_generated.h"

namespace splatbus::model {

namespace {

using Where = std::map<std::uint64_t, std::uint32_t>;

class PageStoreTest : public bus_test::BusTest, public testing::WithParamInterface<Device> {
 protected:
  void SetUp() override {
    if (GetParam() == Device::Cpu) return;
    try {
      static_cast<void>(device::Stream(Device::Cuda));
    } catch (const std::runtime_error& error) {
      GTEST_SKIP() << error.what();
    }
  }

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
    ASSERT_EQ(found.by_id.size(), truth_.gaussians.size());
    ASSERT_EQ(store_->count(), truth_.gaussians.size());
    for (const auto& [id, gaussian] : truth_.gaussians) {
      const auto place = found.by_id.find(id);
      ASSERT_NE(place, found.by_id.end()) << "Gaussian " << id << " is lost";
      ASSERT_EQ(place->second.gaussian, gaussian) << "Gaussian " << id;
    }
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

  std::mt19937 random_{11};
  Truth truth_;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<PageStore> store_;
};

TEST_P(PageStoreTest, ThroughHundredsOfChangesEachGaussianStaysWholeAndInItsPage) {
  churn(200, 6000, 8000);
}

TEST_P(PageStoreTest, ThroughLargeChangesToo) {
  churn(8, 60000, 90000);
}

TEST_P(PageStoreTest, MoreOfOneKeyThanAPageHoldsAreSpreadByTheirIds) {
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

TEST_P(PageStoreTest, PagesThatRemovalsLeftSparseAreMerged) {
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

TEST_P(PageStoreTest, WhereTheFirstPageOfAFrameIsGoneTheNextTakesWhatComesBeforeIt) {
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

TEST_P(PageStoreTest, ABatchIsTakenOnce) {
  start(10000);
  const Batch batch = make_batch(random_, 50, false, 2);
  EXPECT_EQ(insert(*store_, batch, 7, 5).count, 50U);
  EXPECT_EQ(insert(*store_, batch, 7, 5).count, 0U);
  EXPECT_EQ(insert(*store_, batch, 8, 4).count, 0U) << "of an epoch that is over";
  EXPECT_EQ(insert(*store_, batch, 7, 6).count, 50U) << "of a new epoch";
  EXPECT_TRUE(store_->holds(6, 7));
  EXPECT_FALSE(store_->holds(6, 8));
  start(10000);
  EXPECT_TRUE(store_->holds(6, 7));
  EXPECT_THAT(store_->table().batches(), testing::ElementsAre(7));
}

TEST_P(PageStoreTest, AFullModelTakesWhatItHasRoomForAndThenNothing) {
  start(100);
  const Batch batch = make_batch(random_, 80, false, 1);
  EXPECT_EQ(insert(*store_, batch, 1).count, 80U);
  truth_.insert(batch, 80);
  EXPECT_EQ(insert(*store_, batch, 2).count, 20U);
  truth_.insert(batch, 20);
  EXPECT_EQ(insert(*store_, batch, 3).count, 0U);
  EXPECT_TRUE(store_->holds(1, 3)) << "it would be sent for ever";
  expect_sound();
}

TEST_P(PageStoreTest, ANewStoreGoesOnWhereTheLastOneLeft) {
  start(20000);
  const Batch batch = make_batch(random_, 5000, false, 3);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  store_->add_step(4, 0.5);
  const Where before = where();
  for (const std::size_t max_gaussians : {20000, 900000, 20000}) {
    start(max_gaussians);
    EXPECT_EQ(store_->origin(), "adopted 5000 Gaussians at step 1");
    EXPECT_EQ(store_->views(), 4U);
    EXPECT_EQ(where(), before);
    expect_sound();
  }
  EXPECT_GE(store_->table().page_capacity(), 2U * 900000 / kPageLanes);
  insert(*store_, batch, 2);
  truth_.insert(batch, batch.count);
  expect_sound();
}

TEST_P(PageStoreTest, ItGoesOnInEitherKindOfMemory) {
  if (GetParam() == Device::Cpu) GTEST_SKIP() << "needs two kinds";
  start(20000, {}, Device::Cpu);
  const Batch batch = make_batch(random_, 5000, false, 3);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  for (const Device device : {Device::Cuda, Device::Cuda, Device::Cpu, Device::Cuda}) {
    start(20000, {}, device);
    EXPECT_EQ(store_->origin(), "adopted 5000 Gaussians at step 0");
    EXPECT_EQ(store_->device(), device);
    EXPECT_EQ(broker_->statistics().slabs, 2U) << "what it was carried over from is dropped";
    expect_sound();
  }
}

TEST_P(PageStoreTest, WhatIsNotFiniteIsGoneAfterAnAdoption) {
  start(20000);
  const Batch batch = make_batch(random_, 3000, false, 1);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  const float nan = NAN;
  const device::Stream stream(GetParam());
  device::copy(stream, store_->memory().value(17, where().at(5)), &nan, sizeof(nan));
  stream.wait();
  truth_.remove({5});
  start(20000);
  expect_sound();
}

TEST_P(PageStoreTest, AnotherAppearanceBeginsAnew) {
  start(20000);
  insert(*store_, make_batch(random_, 30, false, 1), 1);
  start(20000, {.appearance = Appearance::Radiance, .sh_degree = 1});
  EXPECT_THAT(store_->origin(), testing::HasSubstr("its appearance is another one"));
  EXPECT_EQ(store_->count(), 0U);
}

TEST_P(PageStoreTest, ARadianceModelBeginsWithTheColorThatTheSampleHasUnderTheLight) {
  start(20000, {.appearance = Appearance::Radiance, .sh_degree = 2});
  Batch batch = make_batch(random_, 300, false, 2);
  SceneState scene;
  for (auto& sh : scene.light.ambient_sh) sh = {0.4F, 0.3F, 0.2F};
  scene.light.sun_direction = glm::normalize(glm::vec3(1, 2, 3));
  scene.light.sun_irradiance = {2, 1.5F, 1};
  scene.objects[1].rotation = glm::normalize(glm::quat(0.5F, 0.1F, -0.4F, 0.3F));
  for (std::size_t k = 0; k < batch.count; ++k) {
    glm::vec3 n(batch.normal[k] - 0.5F, batch.normal[batch.count + k] - 0.5F, batch.normal[2 * batch.count + k]);
    n = glm::normalize(n);
    for (std::size_t c = 0; c < 3; ++c) batch.normal[c * batch.count + k] = n[static_cast<int>(c)];
  }
  const RowsOnDevice rows(GetParam(), batch);
  store_->insert(rows.rows, batch.count, scene, 1, 1);
  const Found found(*store_);
  ASSERT_EQ(found.by_id.size(), 300U);
  for (std::size_t k = 0; k < batch.count; ++k) {
    const std::vector<float>& values = found.by_id.at(k + 1).gaussian.values;
    glm::vec3 n(batch.normal[k], batch.normal[batch.count + k], batch.normal[2 * batch.count + k]);
    if (batch.object_id[k] == 1) n = scene.objects[1].rotation * n;
    const float cosine = std::max(0.0F, glm::dot(n, scene.light.sun_direction));
    const glm::vec3 ambient = glm::max(ambient_reflected(scene.light, n), 0.0F);
    for (std::size_t c = 0; c < 3; ++c) {
      const int color = static_cast<int>(c);
      const float lit =
          batch.albedo[c * batch.count + k] *
          (ambient[color] + scene.light.sun_irradiance[color] * batch.visibility[k] * cosine / 3.14159265F);
      const float dc = (srgb_from_linear(std::min(lit, 1.0F)) - 0.5F) / 0.28209479F;
      EXPECT_NEAR(values[11 + c], dc, 1e-4F);
      EXPECT_EQ(values[static_cast<std::size_t>(store_->layout().channels()) + 11 + c], values[11 + c]);
      EXPECT_EQ(values[14 + c], 0.0F);
    }
  }
}

TEST_P(PageStoreTest, VisibilityReachesThePagesThatAreAsTheyWere) {
  start(50000);
  const Batch batch = make_batch(random_, 5000, false, 2);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  const std::uint64_t generation = store_->generation();
  const std::size_t pages = store_->page_count();
  device::Buffer<std::uint8_t> values(device::thread_stream(GetParam()));
  std::vector<std::uint8_t> bytes(store_->view().count);
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<std::uint8_t>(i % 5 * 51);
  const auto set = [&] {
    values.assign(std::span<const std::uint8_t>(bytes));
    values.stream().wait();
    const auto unchanged = store_->unchanged_since(generation, bytes.size());
    store_->set_visibility(values.data(), unchanged);
    return unchanged.size();
  };
  EXPECT_EQ(set(), pages);
  for (auto& [id, place] : Found(*store_).by_id) {
    truth_.gaussians[id].values.back() = static_cast<float>(place.index % 5) * 51 * (1.0F / 255);
  }
  expect_sound();
  const Batch one = make_batch(random_, 1, false, 1);
  insert(*store_, one, 2);
  truth_.insert(one, 1);
  std::fill(bytes.begin(), bytes.end(), 51);
  EXPECT_EQ(set(), pages - 1);
  const Found found(*store_);
  const std::uint32_t changed = found.by_id.at(truth_.next_id - 1).index / kPageLanes;
  for (const auto& [id, place] : found.by_id) {
    if (place.index / kPageLanes != changed) truth_.gaussians[id].values.back() = 51 * (1.0F / 255);
  }
  expect_sound();
}

TEST_P(PageStoreTest, BoundsFollowTheParameters) {
  start(20000);
  const Batch batch = make_batch(random_, 4000, false, 2);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  for (const auto& [id, place] : Found(*store_).by_id) {
    const float x = truth_.gaussians[id].values[0] * 1.5F;
    const device::Stream stream(GetParam());
    device::copy(stream, store_->memory().value(0, place.index), &x, sizeof(x));
    stream.wait();
    truth_.gaussians[id].values[0] = x;
  }
  store_->refresh_bounds();
  expect_sound();
}

TEST_P(PageStoreTest, WhatIsPublishedIsWhereThePagesAre) {
  const auto reader = connect("reader");
  bus::Subscriber subscriber(reader, {"model/published"});
  ASSERT_TRUE(subscriber.wait_connected(std::chrono::seconds(20)));
  start(400000);
  const Batch batch = make_batch(random_, 130000, false, 1);
  insert(*store_, batch, 9);
  store_->publish(bus::Publisher(context_));
  std::optional<bus::Message> message;
  ASSERT_TRUE(bus_test::eventually([&] {
    message = subscriber.receive(std::chrono::milliseconds(20));
    return message.has_value();
  }));
  const auto& published = message->root<wire::ModelPublished>();
  EXPECT_EQ(published.count(), 130000U);
  EXPECT_EQ(published.page_lanes(), kPageLanes);
  EXPECT_EQ(published.page_words(), page_words({}));
  EXPECT_EQ(published.pages(), store_->page_count());
  EXPECT_EQ(published.inserted_batches()->Get(0), 9U);
  const auto table = message->tensor("page_table", bus::ElementType::U8,
                                     {static_cast<std::uint32_t>(page_table_bytes(store_->table().page_capacity()))});
  const auto arena = message->tensor("pages-1", bus::ElementType::U32, {kArenaPages, page_words({})});
  ASSERT_TRUE(table && arena);
  const auto& header = *reinterpret_cast<const PageTableHeader*>(table->data());
  EXPECT_EQ(header.generation, published.generation());
  const PageEntry& entry = page_entries(header)[kArenaPages];
  EXPECT_EQ(entry.now.count, store_->table().entry(kArenaPages).now.count);
  std::vector<std::uint32_t> words(arena->elements());
  ASSERT_TRUE(arena->copy(words.data()));
  const auto in_store = to_host(GetParam(), store_->memory().words + kArenaPages * std::size_t{page_words({})}, 5000);
  EXPECT_TRUE(std::equal(in_store.begin(), in_store.end(), words.begin()));
}

INSTANTIATE_TEST_SUITE_P(Devices, PageStoreTest, testing::Values(Device::Cpu, Device::Cuda),
                         [](const auto& device) { return std::string(name_of(device.param)); });

}  // namespace

}  // namespace splatbus::model
