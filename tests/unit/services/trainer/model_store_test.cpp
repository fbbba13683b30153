#include "trainer/model_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>

#include "../../bus/bus_fixture.h"
#include "sample_batch.h"
#include "wire/model_generated.h"
#include "wire/published_model.h"

namespace splatbus::trainer {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr std::uint64_t kEpoch = 10;

class ModelStoreTest : public bus_test::BusTest {
 protected:
  ModelStoreTest() : reader_(connect("reader")), subscriber_(reader_, {"model/published"}) { restart(); }

  void SetUp() override { ASSERT_TRUE(subscriber_.wait_connected(std::chrono::seconds(20))); }

  /// A trainer process that begins: the one before was killed.
  void restart(std::size_t capacity = 64, const ParameterLayout& layout = {}, std::size_t max_gaussians = 1000) {
    publisher_.reset();
    store_.reset();
    context_ = connect("trainer");
    store_ = std::make_unique<ModelStore>(context_, layout, capacity, max_gaussians);
    publisher_ = std::make_unique<bus::Publisher>(context_, "model/published");
  }

  void append(std::uint64_t batch, std::size_t count, std::uint64_t epoch = kEpoch) {
    store_->change([&] { store_->append(sample_batch(epoch, batch, count, static_cast<unsigned>(batch))); });
  }

  void remove(const std::set<std::size_t>& columns) {
    std::vector<std::uint8_t> dead(store_->count(), 0);
    for (const std::size_t column : columns) dead[column] = 1;
    store_->change([&] { keep_ = kept_columns(store_->remove(dead.data())); });
  }

  std::optional<PublishedModel> publish_and_open() {
    store_->publish(*publisher_);
    const auto message = last_published();
    return message ? PublishedModel::open(*message) : std::nullopt;
  }

  std::optional<bus::Message> last_published() {
    const auto generation = store_->structure().generation;
    std::optional<bus::Message> newest;
    bus_test::eventually([&] {
      if (auto message = subscriber_.receive(std::chrono::milliseconds(20))) newest = std::move(message);
      return newest && newest->root<wire::ModelPublished>("ModelPublished/1").generation() == generation &&
             newest->header().epoch() == context_->epoch();
    });
    return newest;
  }

  bool set_visibility(std::uint64_t generation, const std::vector<float>& values) {
    return store_->set_visibility(generation, values.data(), bus::MemoryKind::Host, values.size());
  }

  /// What the present trainer's header slab holds, for damage.
  SlabHeader& header() {
    header_ = context_->adopt_slab("trainer/model-header");
    return *reinterpret_cast<SlabHeader*>(header_->slot_data(0));
  }
  Structure& current_structure() {
    SlabHeader& of = header();
    return of.structure.at(of.current);
  }

  /// First mean coordinate of every Gaussian by id.
  static std::map<std::uint64_t, float> by_id(const GaussiansView& view) {
    std::map<std::uint64_t, float> result;
    for (std::size_t i = 0; i < view.count; ++i) result[view.gaussian_id[i]] = view.parameters[i];
    return result;
  }

  std::shared_ptr<bus::Context> reader_, context_;
  std::shared_ptr<bus::Slab> header_;
  bus::Subscriber subscriber_;
  std::unique_ptr<ModelStore> store_;
  std::unique_ptr<bus::Publisher> publisher_;
  std::vector<std::uint32_t> keep_;
};

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
  const auto& published = message->root<wire::ModelPublished>("ModelPublished/1");
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

TEST_F(ModelStoreTest, AChangeThatThrowsLeavesTheStructure) {
  append(1, 10);
  EXPECT_THROW(store_->change([&] {
    store_->append(sample_batch(kEpoch, 2, 10));
    throw std::runtime_error("no");
  }),
               std::runtime_error);
  EXPECT_EQ(store_->count(), 10U);
  EXPECT_FALSE(store_->holds(kEpoch, 2));
  EXPECT_EQ(publish_and_open()->live().count, 10U);
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

TEST_F(ModelStoreTest, FreezesAndThawsCells) {
  append(1, 40);
  std::size_t in_cell = 0;
  for (std::size_t i = 0; i < 40; ++i) in_cell += store_->view().cell[i] == 2 ? 1 : 0;
  ASSERT_GT(in_cell, 0U);
  store_->planes().parameters[0] += 1.0F;
  store_->change([&] { EXPECT_EQ(store_->set_frozen({2}, true), in_cell); });
  store_->change([&] { EXPECT_EQ(store_->set_frozen({2}, true), 0U); });
  EXPECT_EQ(store_->structure().frozen, in_cell);
  for (std::size_t i = 0; i < 40; ++i) {
    const bool frozen = (store_->view().flags[i] & kFrozen) != 0;
    EXPECT_EQ(frozen, store_->view().cell[i] == 2);
    if (frozen) {
      EXPECT_EQ(store_->view().parameters[i], store_->planes().average[i]);
    }
  }
  store_->change([&] { EXPECT_EQ(store_->set_frozen({2, 3}, false), in_cell); });
  EXPECT_EQ(store_->structure().frozen, 0U);
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

TEST_F(ModelStoreTest, ARestartedTrainerGoesOnWithTheModel) {
  append(1, 60);
  append(2, 30);  // into a second slab
  for (int i = 0; i < 7; ++i) store_->add_step(2, 0.5);
  remove({5});
  const auto expected = by_id(store_->view());
  const auto generation = store_->structure().generation;
  restart();
  EXPECT_EQ(store_->origin(), "adopted 89 Gaussians at step 7");
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_EQ(store_->views(), 14U);
  EXPECT_DOUBLE_EQ(store_->optimizer_s(), 3.5);
  EXPECT_GT(store_->structure().generation, generation);
  EXPECT_TRUE(store_->holds(kEpoch, 2));
  append(3, 5);
  EXPECT_EQ(by_id(store_->view()).size(), 94U);
  EXPECT_EQ(publish_and_open()->live().count, 94U);
}

TEST_F(ModelStoreTest, OnlyRadianceMindsTheDegree) {
  append(1, 5);
  restart(64, {.appearance = Appearance::Transfer, .sh_degree = 1});
  EXPECT_EQ(store_->count(), 5U) << store_->origin();
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 1});
  EXPECT_EQ(store_->count(), 0U);
  append(2, 5);
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 2});
  EXPECT_EQ(store_->count(), 0U);
}

TEST_F(ModelStoreTest, ATrainerKilledWithinAChangeLeavesTheStructureBefore) {
  append(1, 20);
  const auto expected = by_id(store_->view());
  {
    const auto killed = connect("trainer");
    killed->adopt_slab("trainer/model")->begin_write(0);
  }
  restart();
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_TRUE(publish_and_open());
}

TEST_F(ModelStoreTest, ATrainerKilledWithinARemovalLeavesNothingTwice) {
  append(1, 20);
  auto expected = by_id(store_->view());
  expected.erase(store_->view().gaussian_id[3]);
  store_->planes().move_column(19, 3);  // and no more of the removal
  restart();
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_EQ(store_->count(), 19U);
}

TEST_F(ModelStoreTest, WhatIsNotFiniteIsNotAdopted) {
  append(1, 20);
  store_->planes().parameters[8] = std::numeric_limits<float>::quiet_NaN();
  store_->planes().average[2 * 64 + 9] = std::numeric_limits<float>::infinity();
  restart();
  EXPECT_EQ(store_->count(), 18U);
}

TEST_F(ModelStoreTest, AnotherLayoutOrGarbageBeginsEmptyAndSaysWhy) {
  append(1, 20);
  restart(64, {.appearance = Appearance::Radiance, .sh_degree = 1});
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_THAT(store_->origin(), HasSubstr("appearance"));

  restart();
  current_structure().capacity = 1U << 20;
  restart();
  EXPECT_THAT(store_->origin(), AllOf(HasSubstr("of no use"), HasSubstr("too small for a capacity")));
  current_structure().count = 65;
  restart();
  EXPECT_THAT(store_->origin(), HasSubstr("contradict"));
  header().current = 7;
  restart();
  EXPECT_THAT(store_->origin(), HasSubstr("no current structure"));

  context_->create_slab("model-header", 1, 100);
  restart();
  EXPECT_THAT(store_->origin(), HasSubstr("too small"));
  append(1, 20);
  EXPECT_EQ(publish_and_open()->live().count, 20U);
}

TEST_F(ModelStoreTest, AHeaderWithoutItsPlanesBeginsEmptyAndSaysWhy) {
  append(1, 20);
  context_->drop_slab("model");
  restart();
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_THAT(store_->origin(), HasSubstr("planes are gone"));

  append(1, 20);
  context_->create_slab("model", 1, std::size_t{1} << 20);
  restart();
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_THAT(store_->origin(), HasSubstr("planes of another model"));
}

TEST_F(ModelStoreTest, PlanesWithoutTheirHeaderBeginEmpty) {
  append(1, 20);
  context_->drop_slab("model-header");
  restart();
  EXPECT_EQ(store_->count(), 0U);
  EXPECT_EQ(store_->origin(), "empty");
  EXPECT_EQ(broker_->statistics().slabs, 2U);
}

TEST_F(ModelStoreTest, AMoveThatWasCutShortLeavesTheModelWhereItWas) {
  append(1, 20);
  const auto expected = by_id(store_->view());
  context_->create_slab("model-grown", 1, std::size_t{1} << 20);  // and killed before it counted
  restart();
  EXPECT_EQ(by_id(store_->view()), expected);
  EXPECT_EQ(broker_->statistics().slabs, 2U) << "what was left of the move is dropped";
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

TEST_F(ModelStoreTest, LyingAnnouncementsAreRefused) {
  append(1, 20);
  const auto lie = [&](std::uint64_t count, std::uint64_t capacity, std::uint8_t degree, bool with_planes) {
    bus::MessageInfo info{.schema = "ModelPublished/1"};
    static const std::vector<float> plane(std::size_t{41} * 64);
    if (with_planes) {
      info.tensors.push_back({.name = "parameters", .shape = {41, 64}, .inline_data = plane.data()});
    }
    publisher_->publish(info, [&](auto& builder, auto header) {
      const auto appearance = degree > 0 ? wire::Appearance::Radiance : wire::Appearance::Transfer;
      return wire::CreateModelPublished(builder, header, 77, count, capacity, appearance, degree);
    });
    std::optional<bus::Message> message;
    bus_test::eventually([&] {
      if (auto next = subscriber_.receive(std::chrono::milliseconds(20))) message = std::move(next);
      return message && message->root<wire::ModelPublished>("ModelPublished/1").generation() == 77;
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
