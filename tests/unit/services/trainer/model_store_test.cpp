#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <glm/gtc/quaternion.hpp>
#include <numbers>
#include <set>
#include <stdexcept>

#include "model_store_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(ModelStoreTest, BeginsEmptyAndReadable) {
  EXPECT_EQ(store_->origin(), "empty");
  const auto model = publish_and_open();
  ASSERT_TRUE(model);
  EXPECT_EQ(model->live().count, 0U);
  EXPECT_EQ(model->live().stride, 64U);
}

TEST_F(ModelStoreTest, ReadersSeeWhatWasInserted) {
  append(1, 40);
  store_->add_step(2, 0.5);
  const auto model = publish_and_open();
  ASSERT_TRUE(model);
  EXPECT_EQ(model->step(), 1U);
  const GaussiansView& live = model->live();
  const GaussiansView& average = model->average();
  ASSERT_EQ(live.count, 40U);
  const InsertBatch batch = sample_batch(kEpoch, 1, 40, 1);
  for (std::size_t i = 0; i < 40; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_EQ(live.plane(static_cast<int>(c))[i], batch.mean[c * 40 + i]);
      EXPECT_EQ(live.plane(ParameterLayout::kAlbedo + static_cast<int>(c))[i], batch.albedo[c * 40 + i]);
      EXPECT_EQ(average.plane(static_cast<int>(c))[i], batch.mean[c * 40 + i]) << "an average begins at the value";
      EXPECT_EQ(live.surface_point[c * live.stride + i], batch.mean[c * 40 + i]);
    }
    EXPECT_EQ(live.plane(40)[i], 0.0F);
    EXPECT_EQ(live.cell[i], batch.cell[i]);
    EXPECT_EQ(live.flags[i], 0U);
  }
  EXPECT_EQ(by_id(live).size(), 40U) << "ids are unique";
  store_->planes().parameters[7] = 123.0F;
  EXPECT_EQ(live.parameters[7], 123.0F) << "values are read live";
  EXPECT_TRUE(model->still_valid());
}

TEST_F(ModelStoreTest, TakesABatchOnce) {
  append(1, 10);
  append(2, 10);
  append(1, 10);
  EXPECT_EQ(store_->count(), 20U);
  append(1, 10, kEpoch + 1);
  EXPECT_EQ(store_->count(), 30U) << "another expander's batch 1";
  append(3, 10, kEpoch);
  EXPECT_EQ(store_->count(), 30U) << "an expander that is gone";
  EXPECT_TRUE(store_->holds(kEpoch + 1, 1));
  EXPECT_FALSE(store_->holds(kEpoch + 1, 2));
}

TEST_F(ModelStoreTest, AcknowledgesTheLast4096Batches) {
  store_->change([&] {
    for (std::uint64_t batch = 1; batch <= 5000; ++batch) store_->append(sample_batch(kEpoch, batch, 0));
  });
  EXPECT_FALSE(store_->holds(kEpoch, 904));
  EXPECT_TRUE(store_->holds(kEpoch, 905));
  store_->publish(*publisher_);
  const auto message = last_published();
  ASSERT_TRUE(message);
  const auto& published = message->root<wire::ModelPublished>();
  ASSERT_EQ(published.inserted_batches()->size(), 4096U);
  EXPECT_EQ(published.inserted_batches()->Get(4095), 5000U);
  EXPECT_EQ(published.insert_epoch(), kEpoch);
}

TEST_F(ModelStoreTest, AChangeOfStructureInvalidatesReaders) {
  append(1, 10);
  const auto model = publish_and_open();
  ASSERT_TRUE(model && model->still_valid());
  store_->change([&] {
    EXPECT_FALSE(model->still_valid()) << "while it changes";
    store_->append(sample_batch(kEpoch, 2, 10));
  });
  EXPECT_FALSE(model->still_valid()) << "after it has changed";
  const auto newer = publish_and_open();
  ASSERT_TRUE(newer);
  EXPECT_TRUE(newer->still_valid());
  EXPECT_GT(newer->generation(), model->generation());
  EXPECT_EQ(newer->live().count, 20U);
}

TEST_F(ModelStoreTest, GrowsIntoALargerSlab) {
  append(1, 60);
  const auto old_ids = by_id(store_->view());
  const auto old_model = publish_and_open();
  const auto generation = store_->structure().generation;
  append(2, 60);
  EXPECT_EQ(store_->capacity(), 128U);
  EXPECT_EQ(store_->count(), 120U);
  EXPECT_GT(store_->structure().generation, generation);
  EXPECT_FALSE(old_model->still_valid());
  const auto model = publish_and_open();
  ASSERT_TRUE(model);
  const auto ids = by_id(model->live());
  for (const auto& [id, x] : old_ids) EXPECT_EQ(ids.at(id), x);
  EXPECT_EQ(ids.size(), 120U);
  EXPECT_EQ(broker_->statistics().slabs, 2U) << "the small one was dropped";
}

TEST_F(ModelStoreTest, StopsAtMaxGaussians) {
  restart(64, {}, 50);
  append(1, 40);
  append(2, 40);
  EXPECT_EQ(store_->count(), 50U);
  EXPECT_TRUE(store_->holds(kEpoch, 2)) << "acknowledged, or the expander would repeat it for ever";
  EXPECT_EQ(store_->capacity(), 64U);
}

TEST_F(ModelStoreTest, RemovalKeepsEveryOthersIdAndValues) {
  append(1, 50);
  auto expected = by_id(store_->view());
  const std::vector<std::uint64_t> ids(store_->view().gaussian_id, store_->view().gaussian_id + 50);
  const std::set<std::size_t> gone{0, 3, 4, 30, 48, 49};
  for (const std::size_t column : gone) expected.erase(ids[column]);
  remove(gone);
  EXPECT_EQ(store_->count(), 44U);
  EXPECT_EQ(by_id(store_->view()), expected);
  ASSERT_EQ(keep_.size(), 44U);
  for (std::size_t i = 0; i < 44; ++i) EXPECT_EQ(ids[keep_[i]], store_->view().gaussian_id[i]);
  append(2, 2);
  EXPECT_GT(store_->view().gaussian_id[44], 50U) << "ids are not given twice";
}

TEST_F(ModelStoreTest, RemovesAllOrNone) {
  append(1, 5);
  remove({});
  EXPECT_EQ(store_->count(), 5U);
  remove({0, 1, 2, 3, 4});
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_TRUE(keep_.empty());
}

TEST_F(ModelStoreTest, TakesVisibilityOfColumnsThatHaveNotMoved) {
  append(1, 10);
  const auto generation = store_->structure().generation;
  append(2, 10);
  EXPECT_TRUE(set_visibility(generation, std::vector<float>(10, 0.25F)));
  EXPECT_EQ(store_->view().visibility[9], 0.25F);
  EXPECT_EQ(store_->view().visibility[10], 1.0F) << "younger than that visibility: its own guess stays";
  EXPECT_FALSE(set_visibility(generation, std::vector<float>(21, 0.5F)));
  remove({4});
  EXPECT_FALSE(set_visibility(generation, std::vector<float>(10, 0.5F))) << "columns have moved since";
  EXPECT_TRUE(set_visibility(store_->structure().generation, std::vector<float>(19, 0.75F)));
}

TEST_F(ModelStoreTest, RadianceBeginsWithTheLitColour) {
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 0});
  InsertBatch batch = sample_batch(kEpoch, 1, 1);
  batch.albedo = {0.5F, 0.5F, 0.5F};
  batch.light.ambient_sh = {};
  batch.light.sun_direction = {0, 1, 0};
  batch.light.sun_irradiance = glm::vec3(3.14159265F);
  store_->change([&] { store_->append(batch); });
  const float color = 0.5F + 0.28209479F * store_->view().plane(ParameterLayout::kAppearance)[0];
  EXPECT_NEAR(color, srgb_from_linear(0.5F), 1e-4F);
}

TEST_F(ModelStoreTest, RadianceOfATurnedObjectIsLitByItsNormalInTheWorld) {
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 0});
  InsertBatch batch = sample_batch(kEpoch, 1, 3);
  batch.albedo.assign(9, 0.5F);
  batch.object_id = {0, 7, 8};
  const float third = std::numbers::pi_v<float> / 3.0F;
  batch.objects[7].rotation = glm::angleAxis(third, glm::vec3(0, 0, 1));
  batch.objects[8].rotation = glm::angleAxis(3.0F * third, glm::vec3(1, 0, 0));
  batch.light.ambient_sh = {};
  batch.light.sun_direction = {0, 1, 0};  // along the normals in their own frames
  batch.light.sun_irradiance = glm::vec3(std::numbers::pi_v<float>);
  store_->change([&] { store_->append(batch); });
  const float* const dc = store_->view().plane(ParameterLayout::kAppearance);
  EXPECT_NEAR(0.5F + 0.28209479F * dc[0], srgb_from_linear(0.5F), 1e-4F);
  EXPECT_NEAR(0.5F + 0.28209479F * dc[1], srgb_from_linear(0.25F), 1e-4F);
  EXPECT_NEAR(0.5F + 0.28209479F * dc[2], 0.0F, 1e-4F) << "it lies on its face";
}

TEST_F(ModelStoreTest, LyingAnnouncementsAreRefused) {
  append(1, 20);
  const auto lie = [&](std::uint64_t count, std::uint64_t capacity, std::uint8_t degree, bool with_planes) {
    bus::MessageInfo info;
    static const std::vector<float> plane(std::size_t{41} * 64);
    if (with_planes) {
      info.tensors.push_back({.name = "parameters", .shape = {41, 64}, .inline_data = plane.data()});
    }
    publisher_->publish(topics::kModelPublished, info, [&](auto& builder, auto header) {
      const auto appearance = degree > 0 ? wire::Appearance::Radiance : wire::Appearance::Transfer;
      return wire::CreateModelPublished(builder, header, 77, count, capacity, appearance, degree);
    });
    std::optional<bus::Message> message;
    bus_test::eventually([&] {
      if (auto next = subscriber_.receive(std::chrono::milliseconds(20))) message = std::move(next);
      return message && message->root<wire::ModelPublished>().generation() == 77;
    });
    return PublishedModel::open(message.value());
  };
  EXPECT_THROW(static_cast<void>(lie(65, 64, 0, true)), bus::Error) << "more Gaussians than columns";
  EXPECT_THROW(static_cast<void>(lie(5, 0, 0, true)), bus::Error);
  EXPECT_THROW(static_cast<void>(lie(5, std::uint64_t{1} << 40, 0, true)), bus::Error);
  EXPECT_THROW(static_cast<void>(lie(5, 128, 0, true)), bus::Error) << "planes of another size";
  EXPECT_THROW(static_cast<void>(lie(5, 64, 9, true)), bus::Error) << "no such degree";
  EXPECT_THROW(static_cast<void>(lie(5, 64, 0, true)), bus::Error) << "planes are missing";
  EXPECT_THROW(static_cast<void>(lie(5, 64, 0, false)), bus::Error);
}

}  // namespace
}  // namespace splatbus::trainer
