#include "trainer/optimizer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <set>

#include "../../bus/bus_fixture.h"
#include "bus/error.h"
#include "synthetic_scene.h"
#include "trainer/schedule.h"

namespace splatbus::trainer {
namespace {

class OptimizerTest : public bus_test::BusTest {
 protected:
  void start(const SyntheticScene& scene, const std::function<void(bus::Parameters&)>& configure = {}) {
    for (const auto& view : scene.views()) views_.put(view);
    EXPECT_EQ(parameters_.set("threads", "1", false), "");
    EXPECT_EQ(parameters_.set("input_view_interval", "0", true), "");
    if (configure) configure(parameters_);
    const Options options = parameters_.read<Options>();
    context_ = connect("trainer");
    store_ = std::make_unique<ModelStore>(context_, options.layout, 1024, 4096);
    optimizer_ = make_optimizer(*store_, options);
    schedule_ = std::make_unique<Schedule>(options.seed);
    insert(scene.perturbed());
  }

  void set(const std::string& name, const std::string& value) {
    EXPECT_EQ(parameters_.set(name, value, true), "");
    if (optimizer_) optimizer_->set_options(parameters_.read<Options>());
  }

  bool insert(InsertBatch batch) {
    Commands commands;
    commands.inserts.push_back(std::move(batch));
    return optimizer_->apply(commands);
  }

  /// Mean loss of the steps.
  double train(int steps) {
    double loss = 0;
    for (int i = 0; i < steps; ++i) {
      std::vector<TrainingViewPtr> batch;
      for (int b = 0; b < optimizer_->options().batch; ++b) batch.push_back(schedule_->next(views_, 0));
      loss += optimizer_->step(batch).loss;
    }
    return loss / steps;
  }

  [[nodiscard]] GaussiansView average() const {
    GaussiansView view = store_->view();
    view.parameters = store_->planes().average;
    return view;
  }

  bus::Parameters parameters_{bus::Parameters::declare<Options>()};
  ViewStore views_;
  std::shared_ptr<bus::Context> context_;
  std::unique_ptr<ModelStore> store_;
  std::unique_ptr<Optimizer> optimizer_;
  std::unique_ptr<Schedule> schedule_;
};

TEST_F(OptimizerTest, FindsASceneAgain) {
  const SyntheticScene scene;
  start(scene);
  const double psnr_before = scene.psnr(store_->view());
  const double loss_before = train(6);
  train(228);
  const double loss_after = train(6);
  EXPECT_LT(loss_after, 0.3 * loss_before);
  EXPECT_GT(scene.psnr(store_->view()), psnr_before + 8);
  EXPECT_GT(scene.psnr(average()), psnr_before + 8);
  EXPECT_EQ(store_->step(), 240U);
  EXPECT_EQ(store_->views(), 240U);
  for (int c = ParameterLayout::kAlbedo; c < ParameterLayout::kResidual; ++c) {
    for (std::size_t i = 0; i < store_->count(); ++i) {
      EXPECT_GE(store_->view().plane(c)[i], 0.0F);
      EXPECT_LE(store_->view().plane(c)[i], 1.0F);
    }
  }
}

TEST_F(OptimizerTest, TheAverageIsGoodAfterTwentySteps) {
  const SyntheticScene scene;
  start(scene);
  const double before = scene.psnr(average());
  train(20);
  EXPECT_GT(scene.psnr(average()), before + 1);
  EXPECT_GT(scene.psnr(average()), scene.psnr(store_->view()) - 2);
}

TEST_F(OptimizerTest, TrainsInBatchesWithDepthAndWithoutResidual) {
  const SyntheticScene scene;
  start(scene, [](bus::Parameters& parameters) {
    EXPECT_EQ(parameters.set("batch", "3", true), "");
    EXPECT_EQ(parameters.set("depth_weight", "0.5", true), "");
    EXPECT_EQ(parameters.set("residual", "false", true), "");
  });
  const double before = scene.psnr(store_->view());
  train(80);
  EXPECT_GT(scene.psnr(store_->view()), before + 5);
  EXPECT_EQ(store_->views(), 240U);
  for (int c = ParameterLayout::kResidual; c < store_->layout().channels(); ++c) {
    for (std::size_t i = 0; i < store_->count(); ++i) ASSERT_EQ(store_->view().plane(c)[i], 0.0F);
  }
}

TEST_F(OptimizerTest, TrainsRadiance) {
  const SyntheticScene scene;
  start(scene, [](bus::Parameters& parameters) {
    EXPECT_EQ(parameters.set("appearance", "radiance", false), "");
    EXPECT_EQ(parameters.set("sh_degree", "1", false), "");
  });
  const double loss_before = train(6);
  train(228);
  EXPECT_LT(train(6), 0.5 * loss_before);
}

TEST_F(OptimizerTest, IsTheSameEveryTime) {
  const SyntheticScene scene;
  std::vector<float> first;
  for (int run = 0; run < 2; ++run) {
    if (context_) context_->drop_slab("model");
    start(scene);
    train(20);
    const float* const plane = store_->view().parameters;
    if (run == 0) first.assign(plane, plane + store_->count());
    if (run == 1) {
      EXPECT_EQ(first, std::vector<float>(plane, plane + store_->count()));
    }
  }
}

TEST_F(OptimizerTest, FrozenGaussiansStay) {
  const SyntheticScene scene;
  start(scene);
  Commands commands;
  commands.cells.push_back({.cells = {1}, .freeze = true});
  EXPECT_TRUE(optimizer_->apply(commands));
  const std::vector<float> before(store_->view().parameters, store_->view().parameters + store_->count());
  train(10);
  std::size_t moved = 0;
  for (std::size_t i = 0; i < store_->count(); ++i) {
    if (store_->view().cell[i] == 1) {
      EXPECT_EQ(store_->view().parameters[i], before[i]);
    } else {
      moved += store_->view().parameters[i] != before[i] ? 1 : 0;
    }
  }
  EXPECT_GT(moved, 50U);
}

TEST_F(OptimizerTest, RepeatedBatchesChangeNothing) {
  const SyntheticScene scene;
  start(scene);
  const auto generation = store_->structure().generation;
  EXPECT_FALSE(insert(scene.perturbed()));
  EXPECT_EQ(store_->structure().generation, generation);
  EXPECT_TRUE(insert(sample_batch(1, 2, 10)));
  train(1);
}

TEST_F(OptimizerTest, ABatchThatCannotBeTakenHarmsNoOther) {
  const SyntheticScene scene;
  start(scene);
  store_ = nullptr;
  store_ = std::make_unique<ModelStore>(context_, parameters_.read<Options>().layout, 1024, std::size_t{1} << 44);
  optimizer_ = make_optimizer(*store_, parameters_.read<Options>());
  const std::size_t before = store_->count();
  ASSERT_GT(before, 0U);
  Commands commands;
  commands.inserts.push_back(sample_batch(1, 2, 1500));  // moves the model to a larger slab
  InsertBatch endless = sample_batch(1, 3, 0);
  endless.count = std::size_t{1} << 40;  // no slab is that large
  commands.inserts.push_back(std::move(endless));
  EXPECT_THROW(optimizer_->apply(commands), bus::Error);
  EXPECT_EQ(store_->count(), before);
  EXPECT_GT(store_->capacity(), 1024U);
  EXPECT_LT(train(3), 1.0);
  EXPECT_TRUE(insert(sample_batch(1, 4, 700)));
  train(3);
  EXPECT_EQ(store_->count(), before + 700);
}

TEST_F(OptimizerTest, PrunesWhatIsTransparentHugeOrNotFinite) {
  const SyntheticScene scene;
  start(scene);
  set("prune_interval", "5");
  set("prune_min_age", "5");
  const std::size_t before = store_->count();
  float* const parameters = store_->planes().parameters;
  const std::size_t stride = store_->capacity();
  parameters[ParameterLayout::kOpacityLogit * stride + 3] = -9.0F;
  parameters[ParameterLayout::kLogScale * stride + 4] = 3.0F;
  parameters[20 * stride + 5] = std::numeric_limits<float>::quiet_NaN();
  const auto id = store_->view().gaussian_id[before - 1];
  train(5);
  EXPECT_EQ(store_->count(), before - 3);
  EXPECT_NE(std::find(store_->view().gaussian_id, store_->view().gaussian_id + store_->count(), id),
            store_->view().gaussian_id + store_->count());
  train(5);
}

TEST_F(OptimizerTest, SparesYoungGaussians) {
  const SyntheticScene scene;
  start(scene);
  set("prune_interval", "5");
  set("prune_min_age", "50");
  const std::size_t before = store_->count();
  for (std::size_t i = 0; i < 30; ++i) {
    store_->planes().parameters[ParameterLayout::kOpacityLogit * store_->capacity() + i] = -9.0F;
  }
  train(5);
  EXPECT_EQ(store_->count(), before);
  train(45);
  EXPECT_LE(store_->count(), before - 25);
}

TEST_F(OptimizerTest, ClonesAndSplitsWhenAsked) {
  const SyntheticScene scene;
  start(scene, [](bus::Parameters& parameters) {
    EXPECT_EQ(parameters.set("densify", "true", true), "");
    EXPECT_EQ(parameters.set("densify_interval", "10", true), "");
    EXPECT_EQ(parameters.set("densify_gradient", "1e-6", true), "");
  });
  const std::size_t before = store_->count();
  train(30);
  EXPECT_GT(store_->count(), before);
  std::set<std::uint64_t> ids(store_->view().gaussian_id, store_->view().gaussian_id + store_->count());
  EXPECT_EQ(ids.size(), store_->count());
}

TEST_F(OptimizerTest, KnowsHowWellCellsAreTrained) {
  const SyntheticScene scene;
  start(scene);
  train(12);
  const auto early = optimizer_->cells().cells();
  ASSERT_EQ(early.size(), 4U);
  std::size_t count = 0;
  for (const auto& [id, cell] : early) {
    EXPECT_TRUE(cell.seen);
    EXPECT_GT(cell.loss, 0.0F);
    EXPECT_LT(cell.loss, 0.5F);
    count += cell.count;
  }
  EXPECT_EQ(count, store_->count());
  train(200);
  for (const auto& [id, cell] : optimizer_->cells().cells()) EXPECT_LT(cell.loss, 0.7F * early.at(id).loss);
}

TEST_F(OptimizerTest, AnEmptyModelOrBatchIsNoStep) {
  const SyntheticScene scene;
  start(scene);
  EXPECT_EQ(optimizer_->step({}).steps, 0U);
  EXPECT_EQ(store_->step(), 0U);
}

}  // namespace
}  // namespace splatbus::trainer
