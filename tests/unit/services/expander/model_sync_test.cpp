// The queue of batches, and what follows from what the trainer says that it has.
#include "expander/model_sync.h"

#include <gtest/gtest.h>

#include "../../nanoseconds.h"
#include "expander/retransmit_queue.h"
#include "sample_scene.h"

namespace splatbus::expander {
namespace {

InsertBatch batch_at(float x, std::size_t count = 10) {
  std::vector<glm::vec3> positions;
  for (std::size_t i = 0; i < count; ++i) positions.emplace_back(x + 0.01F * static_cast<float>(i), 0, 0);
  return test::batch_of(positions);
}

std::vector<std::uint64_t> numbers(const std::vector<const InsertBatch*>& batches) {
  std::vector<std::uint64_t> found;
  for (const InsertBatch* batch : batches) found.push_back(batch->batch);
  return found;
}

TEST(RetransmitQueue, RepeatsUntilAcknowledged) {
  RetransmitQueue queue({.in_flight = 2, .resend_ns = kSecond});
  for (int i = 0; i < 3; ++i) queue.add(batch_at(static_cast<float>(i)));
  EXPECT_EQ(numbers(queue.due(1)), (std::vector<std::uint64_t>{1, 2})) << "as many as may be in flight";
  EXPECT_TRUE(queue.due(kSecond / 2).empty());
  EXPECT_EQ(numbers(queue.due(1 + kSecond)), (std::vector<std::uint64_t>{1, 2}));
  const std::vector<std::uint64_t> first{1, 99};
  EXPECT_EQ(queue.acknowledge(first), 1U);
  EXPECT_EQ(numbers(queue.due(2 + kSecond)), std::vector<std::uint64_t>{3});
  queue.set_resend(kSecond / 4);
  EXPECT_EQ(numbers(queue.due(2 + kSecond + kSecond / 4)), (std::vector<std::uint64_t>{2, 3})) << "from now on sooner";
  const std::vector<std::uint64_t> rest{1, 2, 3};
  EXPECT_EQ(queue.acknowledge(rest), 2U);
  EXPECT_EQ(queue.pending(), 0U);
  EXPECT_TRUE(queue.due(100 * kSecond).empty());
  EXPECT_EQ(queue.gaussians(), 30U);
}

TEST(RetransmitQueue, KeepsBatchesForATrainerThatLosesThem) {
  RetransmitQueue queue({.in_flight = 9, .resend_ns = kSecond, .kept_bytes = 3 * batch_at(0).bytes()});
  for (int i = 0; i < 5; ++i) queue.add(batch_at(static_cast<float>(i)));
  const std::vector<std::uint64_t> four{1, 2, 3, 4};
  queue.acknowledge(four);
  EXPECT_EQ(queue.forgotten(), 1U);
  queue.restart();
  EXPECT_EQ(queue.pending(), 4U);
  EXPECT_EQ(numbers(queue.due(1)), (std::vector<std::uint64_t>{6, 7, 8, 9})) << "under numbers of their own";
}

class ModelSyncTest : public testing::Test {
 protected:
  static constexpr std::uint64_t kOwn = 500, kTrainer = 1000;
  void add(const InsertBatch& batch) { inserter_.add(std::vector{&batch}); }
  void insert(float x) {
    queue_.add(batch_at(x));
    add(*queue_.pending_batches().back());
  }
  /// The live model has the points of `live`, or cannot be read.
  void report(const ModelReport& report, const InsertBatch* live = nullptr) {
    const auto adopt_model = [&] {
      if (live == nullptr) return false;
      inserter_.clear();
      add(*live);
      return true;
    };
    sync_.follow(report, adopt_model, inserter_, queue_);
  }
  [[nodiscard]] bool modelled(float x) { return inserter_.holds_any(batch_at(x, 1)); }
  GaussianInserter inserter_{Device::Cpu, test::kCellSize_m};
  RetransmitQueue queue_{RetransmitQueue::Options{}};
  ModelSync sync_{kOwn};
};

TEST_F(ModelSyncTest, AnEmptyTrainerIsTakenAsItIs) {
  EXPECT_FALSE(sync_.settled());
  report({.trainer_epoch = kTrainer});
  EXPECT_TRUE(sync_.settled());
  EXPECT_EQ(sync_.adoptions() + sync_.restarts(), 0U);
}

TEST_F(ModelSyncTest, AcknowledgesWhatIsListedUnderItsOwnEpochOnly) {
  report({.trainer_epoch = kTrainer});
  insert(0);
  insert(5);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 499, .batches = {1, 2}});
  EXPECT_EQ(queue_.pending(), 2U);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = kOwn, .batches = {1}});
  EXPECT_EQ(queue_.pending(), 1U);
}

TEST_F(ModelSyncTest, ARestartedExpanderAdoptsTheLiveModel) {
  const InsertBatch there = batch_at(3);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 7, .batches = {1, 2}});
  EXPECT_FALSE(sync_.settled()) << "its points could not be read";
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 7, .batches = {1, 2}}, &there);
  EXPECT_TRUE(sync_.settled());
  EXPECT_EQ(sync_.adoptions(), 1U);
  EXPECT_TRUE(modelled(3));
  EXPECT_FALSE(modelled(0));
}

TEST_F(ModelSyncTest, ATrainerThatAdoptedItsModelGoesOn) {
  report({.trainer_epoch = kTrainer});
  insert(0);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = kOwn, .batches = {1}});
  report({.trainer_epoch = kTrainer + 1, .count = 10, .insert_epoch = kOwn, .batches = {1}});
  EXPECT_EQ(queue_.pending(), 0U);
  EXPECT_EQ(sync_.restarts() + sync_.adoptions(), 0U);
}

TEST_F(ModelSyncTest, ATrainerThatLostItsModelGetsEverythingAgain) {
  report({.trainer_epoch = kTrainer});
  insert(0);
  insert(5);
  report({.trainer_epoch = kTrainer, .count = 20, .insert_epoch = kOwn, .batches = {1, 2}});
  report({.trainer_epoch = kTrainer + 1});
  EXPECT_EQ(queue_.pending(), 2U);
  EXPECT_EQ(sync_.restarts(), 1U);
  EXPECT_TRUE(modelled(0));
  report({.trainer_epoch = kTrainer + 1});
  EXPECT_EQ(sync_.restarts(), 1U) << "once";
  report({.trainer_epoch = kTrainer + 1, .count = 20, .insert_epoch = kOwn, .batches = {3, 4}});
  EXPECT_EQ(queue_.pending(), 0U);
}

TEST_F(ModelSyncTest, ABatchThatWentInUnseenIsNotRepeated) {
  // Inserted before the trainer said anything; the model that it then shows has the first batch, under a lost list.
  insert(0);
  insert(5);
  const InsertBatch first = *queue_.pending_batches().front();
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 7, .batches = {}}, &first);
  EXPECT_EQ(numbers(queue_.pending_batches()), std::vector<std::uint64_t>{2});
  EXPECT_TRUE(modelled(0));
  EXPECT_TRUE(modelled(5));
}

TEST_F(ModelSyncTest, WhatTheModelHasNoLongerIsNotModelled) {
  report({.trainer_epoch = kTrainer, .generation = 1});
  insert(0);
  insert(5);
  insert(8);
  report({.trainer_epoch = kTrainer, .generation = 2, .count = 20, .insert_epoch = kOwn, .batches = {1, 2}});
  const InsertBatch left = batch_at(5, 4);
  const auto adopt_model = [&] {
    inserter_.clear();
    add(left);
    return true;
  };
  EXPECT_FALSE(sync_.refresh([] { return false; }, inserter_, queue_)) << "its points cannot be read now";
  EXPECT_TRUE(modelled(0));
  EXPECT_TRUE(sync_.refresh(adopt_model, inserter_, queue_));
  EXPECT_FALSE(modelled(0));
  EXPECT_TRUE(modelled(5));
  EXPECT_TRUE(modelled(8)) << "it is on its way";
  EXPECT_EQ(inserter_.modelled().size(), 14U);
  EXPECT_FALSE(sync_.refresh(adopt_model, inserter_, queue_)) << "nothing has changed since";
  report({.trainer_epoch = kTrainer, .generation = 2, .count = 20, .insert_epoch = kOwn, .batches = {1, 2}});
  EXPECT_FALSE(sync_.refresh(adopt_model, inserter_, queue_)) << "nor with values that have";
  report({.trainer_epoch = kTrainer, .generation = 3, .count = 4, .insert_epoch = kOwn, .batches = {1, 2}});
  EXPECT_TRUE(sync_.refresh(adopt_model, inserter_, queue_));
  EXPECT_EQ(sync_.adoptions() + sync_.restarts(), 0U);
}

}  // namespace
}  // namespace splatbus::expander
