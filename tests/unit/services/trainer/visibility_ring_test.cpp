// With which visibility a view is stepped: its own scene version's, of its own lights, by index of the model as it is.
#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <vector>

#include "optimizer_fixture.h"

namespace splatbus::trainer {
namespace {

/// Keeps what the views of the last step came with.
class RecordingStep final : public GradientStep {
 public:
  explicit RecordingStep(std::vector<PairedView>& seen) : seen_(seen) {}
  void set_options(Options& /*options*/) override {}
  void step(std::span<const PairedView> views) override { seen_.assign(views.begin(), views.end()); }
  StepReport finished(bool /*wait*/) override { return {}; }
  void follow(std::span<const IndexRange> /*fresh*/, const model::Moves& /*moves*/) override {}
  [[nodiscard]] kernels::ScreenStatistics statistics() const override { return {}; }
  void clear_statistics() override {}
  [[nodiscard]] raster::PageMoments moments_of(std::uint32_t /*page*/) const override { return {}; }
  void save_moments(std::uint32_t /*page*/, float* /*moments*/) const override {}
  void restore_moments(std::uint32_t /*page*/, raster::PageMoments /*kind*/, const float* /*moments*/) override {}
  [[nodiscard]] device::StreamView stream() const override { return {}; }

 private:
  std::vector<PairedView>& seen_;
};

class VisibilityRingTest : public bus_test::BusTest {
 protected:
  VisibilityRingTest() {
    Options options = bus::Parameters(bus::Parameters::declare<Options>()).read<Options>();
    options.prune.enabled = false;
    store_ = std::make_unique<model::PageStore>(connect("trainer"), options.layout,
                                                model::PageStoreOptions{.max_gaussians = 8192}, Device::Cpu);
    optimizer_ = std::make_unique<Optimizer>(*store_, options, [this](model::PageStore&, const Options&) {
      return std::make_unique<RecordingStep>(stepped_);
    });
    insert(1, 100);
  }

  void insert(std::uint64_t batch_id, std::size_t count) {
    SampleBatch batch = sample_batch(1, batch_id, count, static_cast<unsigned>(batch_id));
    std::fill(batch.visibility.begin(), batch.visibility.end(), 0.2F);
    Commands commands;
    commands.inserts.push_back(batch.on(Device::Cpu));
    ASSERT_TRUE(optimizer_->apply(commands));
  }

  /// A value of its own for each light, version and Gaussian, which tells them apart.
  static std::uint8_t value(std::uint64_t version, std::uint32_t light, std::uint64_t id) {
    return static_cast<std::uint8_t>((13 * version + 29 * light + 3 * id) % 251);
  }

  /// What relight says of the model as it is now.
  [[nodiscard]] VisibilityCommand relit(std::uint64_t version, const std::vector<std::uint32_t>& light_ids) const {
    const HostModel model(*store_);
    const std::size_t count = store_->view().count;
    auto values = bus::allocate_memory(Device::Cpu, count * light_ids.size());
    for (std::size_t row = 0; row < light_ids.size(); ++row) {
      for (std::size_t k = 0; k < model.count(); ++k) {
        values.get()[row * count + model.index(k)] = std::byte{value(version, light_ids[row], model.ids()[k])};
      }
    }
    return {.model_generation = store_->generation(),
            .scene_version = version,
            .count = count,
            .light_ids = light_ids,
            .visibility = std::move(values)};
  }
  void apply(VisibilityCommand&& relit) {
    Commands commands;
    commands.add(std::move(relit));
    const std::vector<std::uint64_t> needed{1, 2, 3, 4};
    optimizer_->apply(commands, needed);
  }

  /// The visibility that a view of that version and those lights is stepped with.
  SceneVisibility stepped(std::uint64_t version, const std::vector<std::uint32_t>& light_ids) {
    TrainingView view;
    view.scene.version = version;
    for (std::size_t k = 1; k < light_ids.size(); ++k) view.scene.light.sources.push_back({.id = light_ids[k]});
    const TrainingViewPtr shared = std::make_shared<const TrainingView>(view);
    optimizer_->step({&shared, 1});
    return stepped_.at(0).visibility;
  }

  /// Of the first `count` Gaussians in the order of their ids it is what relight said.
  void expect_own(const SceneVisibility& visibility, std::uint64_t version, const std::vector<std::uint32_t>& light_ids,
                  std::size_t count) const {
    const HostModel model(*store_);
    ASSERT_NE(visibility.values, nullptr);
    ASSERT_EQ(visibility.rows, light_ids.size());
    ASSERT_GE(visibility.stride, store_->view().count);
    for (std::size_t row = 0; row < light_ids.size(); ++row) {
      for (std::size_t k = 0; k < count; ++k) {
        ASSERT_EQ(visibility.values.get()[row * visibility.stride + model.index(k)],
                  value(version, light_ids[row], model.ids()[k]))
            << "light " << light_ids[row] << ", Gaussian " << k;
      }
    }
  }
  /// Of those after, what the model says of the sun, and all of the others.
  void expect_fresh(const SceneVisibility& visibility, std::size_t first) const {
    const HostModel model(*store_);
    for (std::size_t k = first; k < model.count(); ++k) {
      ASSERT_EQ(visibility.values.get()[model.index(k)], 51) << k;
      for (std::uint32_t row = 1; row < visibility.rows; ++row) {
        ASSERT_EQ(visibility.values.get()[row * visibility.stride + model.index(k)], 255) << k;
      }
    }
  }

  std::vector<PairedView> stepped_;
  std::unique_ptr<model::PageStore> store_;
  std::unique_ptr<Optimizer> optimizer_;
};

/// What replicas of relight share is used once all of them have said theirs, each of its own pages alone.
TEST_F(VisibilityRingTest, PartsOfSeveralReplicasMakeAVersion) {
  insert(2, 3000);
  const std::uint32_t pages = static_cast<std::uint32_t>((store_->view().count + kPageLanes - 1) / kPageLanes);
  ASSERT_GE(pages, 3U);
  const auto part_of = [&](std::uint32_t part, std::uint64_t division) {
    VisibilityCommand command = relit(1, {0, 4});
    command.parts = 2;
    command.part = part;
    command.division = division;
    for (std::uint32_t page = 0; page < pages; ++page) {
      if (page % 2 == part) {
        command.pages.push_back(page);
        continue;
      }
      for (std::size_t row = 0; row < 2; ++row) {  // anything
        const std::size_t first = row * command.count + page * kPageLanes;
        const std::size_t length = std::min<std::size_t>(kPageLanes, command.count - page * kPageLanes);
        std::memset(command.visibility.get() + first, 77, length);
      }
    }
    return command;
  };
  apply(part_of(0, 10));
  EXPECT_EQ(stepped(1, {0, 4}).values, nullptr);
  apply(part_of(1, 11));
  EXPECT_EQ(stepped(1, {0, 4}).values, nullptr) << "of another division";
  apply(part_of(0, 11));
  expect_own(stepped(1, {0, 4}), 1, {0, 4}, 3100);
}

TEST_F(VisibilityRingTest, AViewIsSteppedWithItsOwnVersionAndLightsOrWithNone) {
  apply(relit(1, {0, 4}));
  apply(relit(3, {0, 4, 9}));
  expect_own(stepped(1, {0, 4}), 1, {0, 4}, 100);
  expect_own(stepped(3, {0, 4, 9}), 3, {0, 4, 9}, 100);
  EXPECT_EQ(stepped(2, {0, 4}).values, nullptr) << "of a version between two";
  EXPECT_EQ(stepped(1, {0, 9}).values, nullptr) << "as many lights, but others";
  EXPECT_EQ(stepped(3, {0, 4}).values, nullptr);
  const HostModel model(*store_);
  for (std::size_t k = 0; k < model.count(); ++k) {
    ASSERT_NEAR(model.live().visibility[k] * 255, value(3, 0, model.ids()[k]), 1e-3F)
        << "the newest sun is the model's";
  }
  const auto versions = optimizer_->paired_versions();
  ASSERT_EQ(versions.size(), 2U);
  EXPECT_EQ(versions[0].version, 1U);
  EXPECT_EQ(versions[1].light_ids, (std::vector<std::uint32_t>{0, 4, 9}));
}

TEST_F(VisibilityRingTest, RowsFollowGaussiansThatMoveAndTheNewSeeAllOfTheLights) {
  apply(relit(1, {0, 4, 9}));
  const std::uint32_t place = HostModel(*store_).index(0);
  insert(2, 3000);  // they share no page any more
  ASSERT_NE(HostModel(*store_).index(0), place);
  insert(3, 300);  // some of them where others were before
  insert(4, 2000);
  const SceneVisibility visibility = stepped(1, {0, 4, 9});
  expect_own(visibility, 1, {0, 4, 9}, 100);
  expect_fresh(visibility, 100);
}

/// What relight computed before Gaussians came holds for the pages that are as they were.
TEST_F(VisibilityRingTest, OfAnEarlierStructureThePagesThatAreTheSameAreTaken) {
  VisibilityCommand earlier = relit(2, {0, 4});
  SampleBatch elsewhere = sample_batch(1, 2, 40, 7);
  std::fill(elsewhere.object_id.begin(), elsewhere.object_id.end(), 6U);
  std::fill(elsewhere.visibility.begin(), elsewhere.visibility.end(), 0.2F);
  Commands commands;
  commands.inserts.push_back(elsewhere.on(Device::Cpu));
  ASSERT_TRUE(optimizer_->apply(commands));
  apply(std::move(earlier));
  const SceneVisibility visibility = stepped(2, {0, 4});
  expect_own(visibility, 2, {0, 4}, 100);
  expect_fresh(visibility, 100);
}

/// Bounded: versions that no view is of go, and the oldest beyond the most there may be.
TEST_F(VisibilityRingTest, WhatNoViewNeedsGoes) {
  apply(relit(1, {0}));
  Commands commands;
  commands.add(relit(5, {0}));
  optimizer_->apply(commands, std::vector<std::uint64_t>{4});
  EXPECT_EQ(stepped(1, {0}).values, nullptr);
  EXPECT_NE(stepped(5, {0}).values, nullptr) << "the newest stays";
  EXPECT_EQ(optimizer_->paired_versions().size(), 1U);
}

}  // namespace
}  // namespace splatbus::trainer
