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
