// A store that comes after another one.
#include <cmath>

#include "page_store_fixture.h"

namespace splatbus::model {

namespace {

class PageAdoptionTest : public PageStoreTest {};

TEST_P(PageAdoptionTest, ANewStoreGoesOnWhereTheLastOneLeft) {
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

TEST_P(PageAdoptionTest, ItGoesOnInEitherKindOfMemory) {
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

TEST_P(PageAdoptionTest, WhatIsNotFiniteIsGoneAfterAnAdoption) {
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

TEST_P(PageAdoptionTest, OfAGaussianInTwoLanesOfAnOpenPageTheLaterOneIsWhole) {
  start(20000);
  const Batch batch = make_batch(random_, 600, true, 1);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  std::map<std::uint32_t, std::uint64_t> id_at;
  for (const auto& [id, index] : where()) id_at[index] = id;
  const std::uint32_t removed = id_at.begin()->first, last = removed + store_->view().ranges[0].count - 1;
  // As a removal leaves them that was cut short: the last one's number is in the lane of what goes, its values are not.
  const device::Stream stream(GetParam());
  store_->table().open(removed / kPageLanes);
  device::copy(stream, store_->memory().wide(store_->memory().gaussian_id, removed), &id_at.at(last),
               sizeof(std::uint64_t));
  stream.wait();
  truth_.remove({id_at.at(removed)});
  start(20000);
  expect_sound();
}

TEST_P(PageAdoptionTest, OfTwoTablesTheLaterOneIsTheModels) {
  start(20000);
  start(900000);  // the table moves
  const auto* const memory = reinterpret_cast<const std::byte*>(&store_->table().header());
  const std::vector<std::byte> before(memory, memory + page_table_bytes(store_->table().page_capacity()));
  start(2000000);  // and back
  const Batch batch = make_batch(random_, 500, false, 1);
  insert(*store_, batch, 1);
  truth_.insert(batch, batch.count);
  // As if the process had been killed before it gave up what it moved from.
  {
    const auto slab = context_->create_slab("page-table-moved", 1, before.size(), 10000, Device::Cpu,
                                            bus::Context::SlabLife::ForSuccessor);
    slab->begin_write(0);
    std::memcpy(slab->slot_data(0), before.data(), before.size());
    slab->end_write(0);
  }
  start(2000000);
  EXPECT_EQ(store_->origin(), "adopted 500 Gaussians at step 0");
  expect_sound();
}

TEST_P(PageAdoptionTest, AnotherAppearanceBeginsAnew) {
  start(20000);
  insert(*store_, make_batch(random_, 30, false, 1), 1);
  start(20000, {.appearance = Appearance::Radiance, .sh_degree = 1});
  EXPECT_THAT(store_->origin(), testing::HasSubstr("its appearance is another one"));
  EXPECT_EQ(store_->count(), 0U);
}

TEST_P(PageAdoptionTest, ABatchIsTakenOnce) {
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

INSTANTIATE_TEST_SUITE_P(Devices, PageAdoptionTest, testing::Values(Device::Cpu, Device::Cuda), device_name);

}  // namespace

}  // namespace splatbus::model
