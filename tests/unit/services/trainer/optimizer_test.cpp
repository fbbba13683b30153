#include "trainer/optimizer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "../../bus/bus_fixture.h"
#include "bus/error.h"
#include "synthetic_scene.h"
#include "trainer/view_sampler.h"

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
    sampler_ = std::make_unique<ViewSampler>(options.seed);
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
      for (int b = 0; b < optimizer_->options().batch; ++b) batch.push_back(sampler_->next(views_, 0));
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
  std::unique_ptr<ViewSampler> sampler_;
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
  EXPECT_GT(scene.psnr(store_->view()), before + 13);  // 15 dB when all terms are right
  EXPECT_EQ(store_->views(), 240U);
  for (int c = ParameterLayout::kResidual; c < store_->layout().channels(); ++c) {
    for (std::size_t i = 0; i < store_->count(); ++i) ASSERT_EQ(store_->view().plane(c)[i], 0.0F);
  }
}

TEST_F(OptimizerTest, DepthLossHasTheSlopeOfItsFiniteDifferences) {
  const SyntheticScene scene(40, 1);
  start(scene, [](bus::Parameters& parameters) {
    for (const char* off : {"lr_mean", "lr_log_scale", "lr_rotation", "lr_albedo", "lr_residual", "albedo_weight"}) {
      EXPECT_EQ(parameters.set(off, "0", true), "");
    }
    EXPECT_EQ(parameters.set("lr_opacity", "1e-3", true), "");
    EXPECT_EQ(parameters.set("depth_weight", "100", true), "");  // the picture's loss is nothing beside it
    EXPECT_EQ(parameters.set("prune", "false", true), "");
  });
  TrainingView view = *scene.views().front();
  std::vector<float> depth(view.depth.data(), view.depth.data() + view.depth.size());
  for (float& metres : depth) metres *= 1.2F;  // surfaces lie behind the Gaussians, which should give way
  view.depth = Pixels<float>(std::move(depth));
  const std::vector<TrainingViewPtr> batch{std::make_shared<const TrainingView>(std::move(view))};
  const std::size_t count = store_->count();
  float* const logits = store_->planes().parameters + ParameterLayout::kOpacityLogit * store_->capacity();
  const std::vector<float> before(logits, logits + count);
  optimizer_->step(batch);
  const std::vector<float> after(logits, logits + count);
  std::copy(before.begin(), before.end(), logits);

  set("lr_opacity", "0");
  constexpr float kStep = 0.05F;
  std::size_t steep = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const auto loss_at = [&](float logit) {
      logits[i] = logit;
      const double loss = optimizer_->step(batch).loss;
      logits[i] = before[i];
      return loss;
    };
    const double slope = (loss_at(before[i] + kStep) - loss_at(before[i] - kStep)) / (2 * kStep);
    if (std::abs(slope) < 1e-3) continue;
    ++steep;
    EXPECT_EQ(after[i]<before[i], slope> 0) << "Adam's first step goes down the slope " << slope << " of " << i;
  }
  EXPECT_GT(steep, count / 2);
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

TEST_F(OptimizerTest, RepeatedBatchesChangeNothing) {
  const SyntheticScene scene;
  start(scene);
  const auto generation = store_->structure().generation;
  EXPECT_FALSE(insert(scene.perturbed()));
  EXPECT_EQ(store_->structure().generation, generation);
  EXPECT_TRUE(insert(sample_batch(1, 2, 10)));
  train(1);
}

TEST_F(OptimizerTest, ABatchThatThereIsNoMemoryForLeavesTheModelToTheNextTrainer) {
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

  optimizer_ = nullptr;
  store_ = nullptr;
  context_ = connect("trainer");
  const Options options = parameters_.read<Options>();
  store_ = std::make_unique<ModelStore>(context_, options.layout, 1024, 4096);
  optimizer_ = make_optimizer(*store_, options);
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

TEST_F(OptimizerTest, DensifiesAllThatWasSeenWhereAnyGradientIsEnough) {
  const SyntheticScene scene;
  start(scene, [](bus::Parameters& parameters) {
    EXPECT_EQ(parameters.set("densify", "true", true), "");
    EXPECT_EQ(parameters.set("densify_interval", "10", true), "");
    EXPECT_EQ(parameters.set("densify_gradient", "0", true), "");
    EXPECT_EQ(parameters.set("prune", "false", true), "");
  });
  const std::size_t before = store_->count();
  constexpr std::size_t kHidden = 40;
  for (std::size_t i = 0; i < kHidden; ++i) store_->planes().parameters[i] = 1e4F;
  train(9);
  EXPECT_EQ(store_->count(), before);
  train(1);
  EXPECT_EQ(store_->count(), 2 * before - kHidden);
  const std::set<std::uint64_t> ids(store_->view().gaussian_id, store_->view().gaussian_id + store_->count());
  EXPECT_EQ(ids.size(), store_->count());
}

TEST_F(OptimizerTest, APruningLeavesTheOthersWhatTheyGathered) {
  const SyntheticScene scene;
  start(scene, [](bus::Parameters& parameters) {
    EXPECT_EQ(parameters.set("densify", "true", true), "");
    EXPECT_EQ(parameters.set("densify_interval", "6", true), "");
    EXPECT_EQ(parameters.set("densify_gradient", "0", true), "");
    EXPECT_EQ(parameters.set("densify_scale", "1000", true), "");  // clones only
    EXPECT_EQ(parameters.set("prune_interval", "5", true), "");
    EXPECT_EQ(parameters.set("prune_min_age", "5", true), "");
  });
  const std::size_t last = store_->count() - 1;
  float* const parameters = store_->planes().parameters;
  parameters[ParameterLayout::kLogScale * store_->capacity() + 3] = 3.0F;  // seen, and pruned
  parameters[last] = 1e4F;                                                 // never seen, and moved to its place
  train(5);
  ASSERT_EQ(store_->count(), last);
  EXPECT_EQ(parameters[3], 1e4F);
  train(1);
  EXPECT_EQ(store_->count(), 2 * last - 1) << "all but one were cloned";
  EXPECT_EQ(std::count(parameters, parameters + store_->count(), 1e4F), 1);
}

TEST_F(OptimizerTest, AnEmptyModelOrBatchIsNoStep) {
  const SyntheticScene scene;
  start(scene);
  EXPECT_EQ(optimizer_->step({}).steps, 0U);
  EXPECT_EQ(store_->step(), 0U);
}

}  // namespace
}  // namespace splatbus::trainer
