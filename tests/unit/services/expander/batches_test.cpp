// Initial Gaussians, the ledger and the follower of the trainer's model.
#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/constants.hpp>
#include <limits>

#include "expander/batch_ledger.h"
#include "expander/cpu_mapper.h"
#include "expander/insert_batch.h"
#include "expander/model_follower.h"
#include "expander/visibility.h"
#include "sample_scene.h"

namespace splatbus::expander {
namespace {

std::vector<float> copy_of(const float* plane, std::size_t values) {
  return {plane, plane + values};
}

constexpr std::int64_t kSecond = 1'000'000'000;

TEST(InitialGaussians, AreFlatAlongTheNormalAndOfTheSpacing) {
  InputSamples samples = test::empty_round();
  const glm::vec3 normal = glm::normalize(glm::vec3(1, 2, -0.5F));
  test::add_sample(samples, {1, 2, 3}, 9, normal);
  const std::vector<Chosen> chosen{{.sample = 0, .cell = 77, .position = {1, 2, 3}, .normal = normal}};
  const InsertBatch batch = initial_gaussians(samples, chosen, {.scale = 0.4F, .flatness = 0.25F, .opacity = 0.9F});
  ASSERT_EQ(batch.size(), 1U);
  const InsertPlanes planes = batch.planes();
  EXPECT_EQ(copy_of(planes.mean, 3), (std::vector<float>{1, 2, 3}));
  EXPECT_NEAR(std::exp(planes.log_scale[0]), 0.4F * test::kSpacing, 1e-6F);
  EXPECT_NEAR(std::exp(planes.log_scale[1]), 0.4F * test::kSpacing, 1e-6F);
  EXPECT_NEAR(std::exp(planes.log_scale[2]), 0.1F * test::kSpacing, 1e-6F);
  const glm::quat rotation(planes.rotation[0], planes.rotation[1], planes.rotation[2], planes.rotation[3]);
  EXPECT_LT(glm::distance(rotation * glm::vec3(0, 0, 1), normal), 1e-5F);
  EXPECT_NEAR(1 / (1 + std::exp(-planes.opacity_logit[0])), 0.9F, 1e-5F);
  EXPECT_EQ(planes.object_id[0], 9U);
  EXPECT_EQ(planes.cell[0], 77U);
}

TEST(InitialGaussians, LieInPlanes) {
  InputSamples samples = test::floor_round(0, 0.1F);
  std::vector<Chosen> chosen;
  for (std::uint32_t i = 0; i < samples.size(); ++i) {
    chosen.push_back({.sample = i, .cell = i, .position = {static_cast<float>(i), 10, 20}, .normal = {0, 1, 0}});
  }
  const InsertBatch batch = initial_gaussians(samples, chosen, {});
  ASSERT_EQ(batch.size(), 4U);
  EXPECT_EQ(copy_of(batch.planes().mean, 12), (std::vector<float>{0, 1, 2, 3, 10, 10, 10, 10, 20, 20, 20, 20}));
  EXPECT_EQ(batch.planes().object_id + 4, static_cast<void*>(batch.data.get() + batch.bytes())) << "nothing behind";
}

TEST(RotationToNormal, TurnsZThereFromEverywhere) {
  for (const glm::vec3& direction : {glm::vec3(0, 0, 1), glm::vec3(0, 0, -1), glm::vec3(1e-4F, 0, -1),
                                     glm::vec3(0.01F, 0.02F, -1), glm::vec3(1, 0, 0), glm::vec3(-1, 2, -3)}) {
    const glm::vec3 normal = glm::normalize(direction);
    const glm::quat rotation = rotation_to_normal(normal);
    EXPECT_NEAR(glm::length(rotation), 1, 1e-5F);
    EXPECT_LT(glm::distance(rotation * glm::vec3(0, 0, 1), normal), 2e-2F) << normal.x << ' ' << normal.y;
  }
}

TEST(GuessVisibility, TellsSunFromShadow) {
  Light light;
  light.sun_direction = {0, 1, 0};
  light.sun_irradiance = glm::vec3(2);
  light.ambient_sh[0] = glm::vec3(0.5F);
  const glm::vec3 albedo(0.6F, 0.5F, 0.4F);
  const glm::vec3 up(0, 1, 0);
  const glm::vec3 ambient = albedo * ambient_reflected(light, up);
  const glm::vec3 sun = albedo * light.sun_irradiance / glm::pi<float>();
  EXPECT_NEAR(guess_visibility(ambient + sun, albedo, up, light), 1, 1e-5F);
  EXPECT_NEAR(guess_visibility(ambient, albedo, up, light), 0, 1e-5F);
  EXPECT_NEAR(guess_visibility(ambient + 0.3F * sun, albedo, up, light), 0.3F, 1e-5F);
  EXPECT_EQ(guess_visibility(ambient + 9.0F * sun, albedo, up, light), 1);
  EXPECT_EQ(guess_visibility(glm::vec3(0), albedo, {0, -1, 0}, light), 1) << "turned away from the sun";
  EXPECT_EQ(guess_visibility(glm::vec3(0), glm::vec3(0), up, light), 1) << "black";
}

TEST(DropGarbage, LeavesWhatIsSound) {
  InputSamples samples = test::floor_round(0, 0.5F);
  const std::size_t sound = samples.size();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (int i = 0; i < 8; ++i) test::add_sample(samples, {0, 0, 0});
  samples.position[sound].y = nan;
  samples.normal[sound + 1] = {0, 0, 0};
  samples.spacing_m[sound + 2] = 0;
  samples.spacing_m[sound + 3] = nan;
  samples.camera[sound + 4] = 5;
  samples.albedo[sound + 5].x = std::numeric_limits<float>::infinity();
  samples.cosine[sound + 6] = nan;
  samples.spacing_m[sound + 7] = 1e9F;
  drop_garbage(samples);
  EXPECT_EQ(samples.size(), sound);
  EXPECT_EQ(samples.dropped, 8U);
  EXPECT_EQ(samples.camera.size(), sound);
}

InsertBatch batch_at(float x, std::size_t count = 10) {
  InputSamples samples = test::empty_round();
  std::vector<Chosen> chosen;
  chosen.reserve(count);
  for (std::uint32_t i = 0; i < count; ++i) {
    const glm::vec3 position(x + 0.01F * static_cast<float>(i), 0, 0);
    test::add_sample(samples, position);
    chosen.push_back({.sample = i, .cell = *cell_at(position, {}, 0.25F), .position = position, .normal = {0, 1, 0}});
  }
  return initial_gaussians(samples, chosen, {});
}

std::vector<std::uint64_t> numbers(const std::vector<const InsertBatch*>& batches) {
  std::vector<std::uint64_t> found;
  for (const InsertBatch* batch : batches) found.push_back(batch->batch);
  return found;
}

TEST(BatchLedger, RepeatsUntilAcknowledged) {
  BatchLedger ledger({.in_flight = 2, .resend_ns = kSecond});
  for (int i = 0; i < 3; ++i) ledger.add(batch_at(static_cast<float>(i)));
  EXPECT_EQ(numbers(ledger.due(1)), (std::vector<std::uint64_t>{1, 2})) << "as many as may be in flight";
  EXPECT_TRUE(ledger.due(kSecond / 2).empty());
  EXPECT_EQ(numbers(ledger.due(1 + kSecond)), (std::vector<std::uint64_t>{1, 2}));
  const std::vector<std::uint64_t> first{1, 99};
  EXPECT_EQ(ledger.acknowledge(first), 1U);
  EXPECT_EQ(numbers(ledger.due(2 + kSecond)), std::vector<std::uint64_t>{3});
  const std::vector<std::uint64_t> rest{1, 2, 3};
  EXPECT_EQ(ledger.acknowledge(rest), 2U);
  EXPECT_EQ(ledger.pending(), 0U);
  EXPECT_TRUE(ledger.due(100 * kSecond).empty());
  EXPECT_EQ(ledger.gaussians(), 30U);
}

TEST(BatchLedger, KeepsBatchesForATrainerThatLosesThem) {
  BatchLedger ledger({.in_flight = 9, .resend_ns = kSecond, .kept_bytes = 3 * batch_at(0).bytes()});
  for (int i = 0; i < 5; ++i) ledger.add(batch_at(static_cast<float>(i)));
  const std::vector<std::uint64_t> four{1, 2, 3, 4};
  ledger.acknowledge(four);
  EXPECT_EQ(ledger.forgotten(), 1U);
  ledger.restart();
  EXPECT_EQ(ledger.pending(), 4U);
  EXPECT_EQ(numbers(ledger.due(1)), (std::vector<std::uint64_t>{6, 7, 8, 9})) << "under numbers of their own";
}

class ModelFollowerTest : public testing::Test {
 protected:
  static constexpr std::uint64_t kOwn = 500, kTrainer = 1000;
  void insert(float x) {
    ledger_.add(batch_at(x));
    mapper_.add(*ledger_.pending_batches().back());
  }
  /// The live model has the points of `live`, or cannot be read.
  void report(const ModelReport& report, const InsertBatch* live = nullptr) {
    const auto adopt_model = [&] {
      if (live == nullptr) return false;
      mapper_.clear();
      mapper_.add(*live);
      return true;
    };
    follower_.follow(report, adopt_model, mapper_, ledger_);
  }
  [[nodiscard]] bool modelled(float x) const {
    return mapper_.grid().covered(*cell_at({x, 0, 0}, {}, 0.25F), {x, 0, 0}, {0, 1, 0}, 0.005F);
  }
  CpuMapper mapper_{0.25F};
  BatchLedger ledger_{BatchLedger::Options{}};
  ModelFollower follower_{kOwn};
};

TEST_F(ModelFollowerTest, AnEmptyTrainerIsTakenAsItIs) {
  EXPECT_FALSE(follower_.settled());
  report({.trainer_epoch = kTrainer});
  EXPECT_TRUE(follower_.settled());
  EXPECT_EQ(follower_.adoptions() + follower_.restarts(), 0U);
}

TEST_F(ModelFollowerTest, AcknowledgesWhatIsListedUnderItsOwnEpochOnly) {
  report({.trainer_epoch = kTrainer});
  insert(0);
  insert(5);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 499, .batches = {1, 2}});
  EXPECT_EQ(ledger_.pending(), 2U);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = kOwn, .batches = {1}});
  EXPECT_EQ(ledger_.pending(), 1U);
}

TEST_F(ModelFollowerTest, ARestartedExpanderAdoptsTheLiveModel) {
  const InsertBatch there = batch_at(3);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 7, .batches = {1, 2}});
  EXPECT_FALSE(follower_.settled()) << "its points could not be read";
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 7, .batches = {1, 2}}, &there);
  EXPECT_TRUE(follower_.settled());
  EXPECT_EQ(follower_.adoptions(), 1U);
  EXPECT_TRUE(modelled(3));
  EXPECT_FALSE(modelled(0));
}

TEST_F(ModelFollowerTest, ATrainerThatAdoptedItsModelGoesOn) {
  report({.trainer_epoch = kTrainer});
  insert(0);
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = kOwn, .batches = {1}});
  report({.trainer_epoch = kTrainer + 1, .count = 10, .insert_epoch = kOwn, .batches = {1}});
  EXPECT_EQ(ledger_.pending(), 0U);
  EXPECT_EQ(follower_.restarts() + follower_.adoptions(), 0U);
}

TEST_F(ModelFollowerTest, ATrainerThatLostItsModelGetsEverythingAgain) {
  report({.trainer_epoch = kTrainer});
  insert(0);
  insert(5);
  report({.trainer_epoch = kTrainer, .count = 20, .insert_epoch = kOwn, .batches = {1, 2}});
  report({.trainer_epoch = kTrainer + 1});
  EXPECT_EQ(ledger_.pending(), 2U);
  EXPECT_EQ(follower_.restarts(), 1U);
  EXPECT_TRUE(modelled(0));
  report({.trainer_epoch = kTrainer + 1});
  EXPECT_EQ(follower_.restarts(), 1U) << "once";
  report({.trainer_epoch = kTrainer + 1, .count = 20, .insert_epoch = kOwn, .batches = {3, 4}});
  EXPECT_EQ(ledger_.pending(), 0U);
}

TEST_F(ModelFollowerTest, ABatchThatWentInUnseenIsNotRepeated) {
  // Inserted before the trainer said anything; the model that it then shows has the first batch, under a lost list.
  insert(0);
  insert(5);
  const InsertBatch first = *ledger_.pending_batches().front();
  report({.trainer_epoch = kTrainer, .count = 10, .insert_epoch = 7, .batches = {}}, &first);
  EXPECT_EQ(numbers(ledger_.pending_batches()), std::vector<std::uint64_t>{2});
  EXPECT_TRUE(modelled(0));
  EXPECT_TRUE(modelled(5));
}

}  // namespace
}  // namespace splatbus::expander
