// What a store takes, what its pages then say, and what it publishes of them.
#include <algorithm>
#include <cmath>

#include "page_store_fixture.h"
#include "wire/model_generated.h"
#include "wire/model_limits.h"

namespace splatbus::model {

namespace {

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

TEST_P(PageStoreTest, AModelMayBeAsLargeAsTheLimitSays) {
  start(kGaussianLimit);
  EXPECT_EQ(store_->room(), kGaussianLimit);
  const Batch batch = make_batch(random_, 80, false, 1);
  EXPECT_EQ(insert(*store_, batch, 1).count, 80U);
  truth_.insert(batch, 80);
  expect_sound();
  EXPECT_THROW(start(kGaussianLimit + kGaussianLimit / 50), std::invalid_argument);
}

TEST_P(PageStoreTest, ARadianceModelBeginsWithTheColorThatTheSampleHasUnderTheLight) {
  start(20000, {.appearance = Appearance::Radiance, .sh_degree = 2});
  Batch batch = make_batch(random_, 300, false, 2);
  SceneState scene;
  for (auto& sh : scene.light.ambient_sh) sh = {0.4F, 0.3F, 0.2F};
  scene.light.sun_direction = glm::normalize(glm::vec3(1, 2, 3));
  scene.light.sun_irradiance = {2, 1.5F, 1};
  scene.objects[1].rigid.rotation = glm::normalize(glm::quat(0.5F, 0.1F, -0.4F, 0.3F));
  scene.objects[2].emissive = true;
  for (std::size_t k = 0; k < batch.count; ++k) {
    batch.object_id[k] = static_cast<std::uint32_t>(k % 3);
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
    if (batch.object_id[k] == 1) n = scene.objects[1].rigid.rotation * n;
    const float cosine = std::max(0.0F, glm::dot(n, scene.light.sun_direction));
    const glm::vec3 ambient = glm::max(ambient_reflected(scene.light, n), 0.0F);
    for (std::size_t c = 0; c < 3; ++c) {
      const int color = static_cast<int>(c);
      const float light = batch.object_id[k] == 2 ? 1.0F
                                                  : ambient[color] + scene.light.sun_irradiance[color] *
                                                                         batch.visibility[k] * cosine / 3.14159265F;
      const float lit = batch.albedo[c * batch.count + k] * light;
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

TEST_P(PageStoreTest, FrozenPagesTakeTheirAveragesAndRestUntilTheirStructureChanges) {
  start(50000);
  const Batch batch = make_batch(random_, 6000, false, 2);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  const device::Stream stream(GetParam());
  const std::size_t channels = 41;
  for (const auto& [id, place] : Found(*store_).by_id) {
    const float live = truth_.gaussians[id].values[0] + 3;
    device::copy(stream, store_->memory().value(0, place.index), &live, sizeof(live));
    const float average = truth_.gaussians[id].values[0] + 1;
    device::copy(stream, store_->memory().value(channels, place.index), &average, sizeof(average));
    truth_.gaussians[id].values[0] = live;
    truth_.gaussians[id].values[channels] = average;
  }
  stream.wait();
  std::vector<std::uint32_t> pages;
  for (const IndexRange& range : store_->view().ranges) pages.push_back(range.first / kPageLanes);
  ASSERT_GT(pages.size(), 4U);
  std::vector<std::uint32_t> chosen;
  for (std::size_t p = 0; p < pages.size(); p += 2) chosen.push_back(pages[p]);
  std::vector<std::uint64_t> before;
  for (const std::uint32_t page : pages) before.push_back(store_->table().entry(page).generation);
  chosen.push_back(store_->table().page_capacity() - 1);  // a free one is left as it is
  store_->freeze(chosen);
  chosen.pop_back();
  std::size_t rest = 0;
  for (std::size_t p = 0; p < pages.size(); ++p) {
    const IndexRange range = store_->view().ranges[p];
    EXPECT_EQ(range.frozen, p % 2 == 0 ? 1U : 0U);
    EXPECT_EQ(store_->table().entry(pages[p]).now.state, p % 2 == 0 ? PageState::Frozen : PageState::Active);
    EXPECT_EQ(store_->table().entry(pages[p]).generation != before[p], p % 2 == 0);
    if (p % 2 == 0) rest += range.count;
  }
  EXPECT_EQ(store_->frozen_pages(), chosen.size());
  EXPECT_EQ(store_->frozen_count(), rest);
  EXPECT_EQ(store_->count(), 6000U);
  for (const auto& [id, place] : Found(*store_).by_id) {
    if (std::ranges::find(chosen, place.index / kPageLanes) == chosen.end()) continue;
    truth_.gaussians[id].values[0] = truth_.gaussians[id].values[channels];
  }
  const PageBounds rests = store_->view().bounds.front(), moves = store_->view().bounds[1];
  store_->refresh_bounds(0.5F, 2);
  EXPECT_EQ(store_->view().bounds.front().high.x, rests.high.x);
  EXPECT_GT(store_->view().bounds[1].high.x, moves.high.x);
  store_->refresh_bounds();
  expect_sound();

  // Who comes after a death finds them as they were.
  start(50000);
  EXPECT_EQ(store_->frozen_pages(), chosen.size());
  expect_sound();

  // One is thawed, one takes a Gaussian in, one loses one; the fourth is as it was.
  store_->thaw(std::span(chosen).first(1));
  EXPECT_EQ(store_->table().entry(chosen[0]).now.state, PageState::Active);
  const auto id_in = [&](std::uint32_t page) {
    for (const auto& [id, place] : Found(*store_).by_id) {
      if (place.index / kPageLanes == page) return id;
    }
    throw std::logic_error("an empty page");
  };
  const std::uint64_t gone = id_in(chosen[1]);
  remove(*store_, indices_of({gone}));
  truth_.remove({gone});
  EXPECT_EQ(store_->table().entry(chosen[1]).now.state, PageState::Active);
  const std::uint64_t original = id_in(chosen[2]);
  duplicate(*store_, indices_of({original}));
  truth_.duplicate({original});
  EXPECT_EQ(store_->frozen_pages(), chosen.size() - 3);
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
  const auto arena = message->tensor("pages-1", bus::ElementType::U32, {0, page_words({})});
  ASSERT_TRUE(table && arena);
  const auto& header = *reinterpret_cast<const PageTableHeader*>(table->data());
  std::uint32_t last = 0;
  for (std::uint32_t page = 0; page < store_->table().page_capacity(); ++page) {
    if (page_entries(header)[page].now.count > 0) last = page;
  }
  EXPECT_EQ(kArenaPages + arena->dim(0), last + 1) << "as many pages as are in use, not as there is memory for";
  EXPECT_LT(arena->dim(0), kArenaPages);
  EXPECT_EQ(header.generation, published.generation());
  const PageEntry& entry = page_entries(header)[kArenaPages];
  EXPECT_EQ(entry.now.count, store_->table().entry(kArenaPages).now.count);
  std::vector<std::uint32_t> words(arena->elements());
  ASSERT_TRUE(arena->copy(words.data()));
  const auto in_store = to_host(GetParam(), store_->memory().words + kArenaPages * std::size_t{page_words({})}, 5000);
  EXPECT_TRUE(std::equal(in_store.begin(), in_store.end(), words.begin()));
}

INSTANTIATE_TEST_SUITE_P(Devices, PageStoreTest, testing::Values(Device::Cpu, Device::Cuda), device_name);

}  // namespace

}  // namespace splatbus::model
