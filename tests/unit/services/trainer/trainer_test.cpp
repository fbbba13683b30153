#include "trainer/trainer.h"

#include <gtest/gtest.h>

#include <atomic>
#include <limits>
#include <memory>
#include <new>
#include <numeric>

#include "bus/error.h"
#include "bus/memory.h"
#include "trainer/memory_failure.h"
#include "trainer_fixture.h"

namespace splatbus::trainer {
namespace {

TEST_F(TrainerTest, TrainsToTheStepAskedForAndNoFurther) {
  const SyntheticScene scene;
  set("run_until", "25");
  start();
  insert(scene.perturbed());
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->step() == 25 && stats()->paused(); }));
  ASSERT_TRUE(until([&] { return published()->step() == 25; }));
  EXPECT_EQ(stats()->views(), 25U);
  EXPECT_GT(stats()->optimizer_s(), 0.0);
  EXPECT_GT(stats()->steps_per_s(), 0.0);
  const auto model = read_model();
  ASSERT_TRUE(model);
  const double psnr = scene.psnr(model->average());

  set("run_until", "120");
  ASSERT_TRUE(until([&] { return stats()->step() == 120 && stats()->paused(); }));
  EXPECT_GT(scene.psnr(read_model()->average()), psnr + 1) << "the same message, whose pages are read live";
}

TEST_F(TrainerTest, RestsWhilePaused) {
  const SyntheticScene scene;
  set("paused", "true");
  start();
  insert(scene.perturbed());
  show(scene);
  EXPECT_TRUE(stats()->paused());
  EXPECT_EQ(stats()->step(), 0U);
  set("paused", "false");
  EXPECT_TRUE(until([&] { return stats()->step() > 0; }));
}

TEST_F(TrainerTest, TakesABatchOnceHoweverOftenItIsSent) {
  start();
  const SampleBatch batch = sample_batch(0, 7, 50);
  insert(batch);
  for (int i = 0; i < 5; ++i) publish_insert(batch);
  insert(sample_batch(0, 8, 20));
  EXPECT_EQ(published()->count(), 70U);
}

TEST_F(TrainerTest, BadInsertsHarmNobody) {
  start();
  insert(sample_batch(0, 1, 10));
  SampleBatch damaged = sample_batch(0, 2, 10);
  damaged.mean[4] = std::numeric_limits<float>::quiet_NaN();
  publish_insert(sample_batch(0, 3, 10), "albedo");  // a plane is missing
  SampleBatch short_plane = sample_batch(0, 4, 10);
  publisher_.publish(Topic<wire::ModelInsert>{"model/insert", false, "ModelInsert/99"},
                     [&](auto& builder, auto header) {
                       const auto light = to_wire(builder, Light{});
                       return wire::CreateModelInsert(builder, header, 5, 0, light);
                     });
  publisher_.publish(Topic<wire::TrainerStats>{"model/insert", false, kSchema<wire::ModelInsert>},
                     [&](auto& builder, auto header) {
                       return wire::CreateTrainerStats(builder, header, 6);  // another table under that name
                     });
  insert(damaged);
  EXPECT_EQ(published()->count(), 19U) << "all but the row that was not finite";
  EXPECT_FALSE(holds(3));
  insert(sample_batch(0, 9, 1));
  EXPECT_EQ(published()->count(), 20U);
}

TEST_F(TrainerTest, BadViewsAreRefusedAndRetiredOnesForgotten) {
  const SyntheticScene scene;
  start();
  publish_view(*scene.views()[0], false, 4);  // a picture of another size than its camera's
  show(scene);
  ASSERT_TRUE(until([&] {
    publish_view(*scene.views()[2], true);
    return stats()->ready_references() == scene.views().size() - 1;
  }));
}

TEST_F(TrainerTest, TakesVisibility) {
  start();
  insert(sample_batch(0, 1, 40));
  std::vector<std::uint8_t> seen(kPageLanes, 51);  // by index
  const HostModel before = read_model().value();
  seen[before.index(1)] = 0;
  seen[before.index(2)] = 255;
  ASSERT_TRUE(until([&] {
    publish_visibility(seen, published()->generation());
    return std::abs(read_model()->live().visibility[0] - 0.2F) < 1e-6F;
  }));
  const HostModel model = read_model().value();
  EXPECT_EQ(model.live().visibility[1], 0.0F);
  EXPECT_EQ(model.live().visibility[2], 1.0F);
}

TEST_F(TrainerTest, CarvesWhatPicturesShowFree) {
  const SyntheticScene scene;
  set("paused", "true");
  start();
  SampleBatch before_cameras = sample_batch(1, 2, 40);  // a metre before each in turn
  std::fill(before_cameras.log_scale.begin(), before_cameras.log_scale.end(), std::log(0.02F));
  for (std::size_t i = 0; i < 40; ++i) {
    const Camera& camera = scene.views()[i % scene.views().size()]->camera;
    const glm::vec3 at = unproject(camera, 20 + static_cast<float>(i % 8), 24, 1);
    for (int axis = 0; axis < 3; ++axis) before_cameras.mean[static_cast<std::size_t>(axis) * 40 + i] = at[axis];
  }
  insert(scene.truth());
  insert(before_cameras);
  ASSERT_EQ(published()->count(), 340U);
  std::uint64_t frame = 10;
  ASSERT_TRUE(until([&] {
    ++frame;
    for (const auto& view : scene.views()) {
      TrainingView newer = *view;
      newer.frame = frame;
      publish_view(newer);
    }
    return published()->count() < 340;
  }));
  const HostModel model = read_model().value();
  EXPECT_EQ(model.count(), 300U);
  EXPECT_EQ(model.ids().back(), 300U) << "those of the first batch";
}

TEST_F(TrainerTest, AViewWaitsForTheVisibilityOfItsOwnScene) {
  set("pair_visibility", "true");
  start();
  insert(sample_batch(0, 1, 40));
  const SyntheticScene scene(20, 1);
  TrainingView view = *scene.views()[0];
  view.scene.version = 7;
  const std::vector<std::uint8_t> seen(kPageLanes, 255);
  ASSERT_TRUE(until([&] {
    publish_view(view);
    publish_visibility(seen, published()->generation(), 6);
    return stats() != nullptr && stats()->unpaired_views() > 0;
  }));
  EXPECT_EQ(stats()->step(), 0U) << "another version's visibility is no pair";
  ASSERT_TRUE(until([&] {
    publish_visibility(seen, published()->generation(), 7);
    return stats()->step() > 0;
  }));
}

TEST_F(TrainerTest, AViewThatCameBeforeItsVisibilityWasAskedForTrainsOnceThatIsThere) {
  const SyntheticScene scene(20, 1);
  TrainingView view = *scene.views()[0];
  view.scene.version = 7;
  start();
  insert(sample_batch(0, 1, 40));
  ASSERT_TRUE(until([&] {
    publish_view(view);
    return stats() != nullptr && stats()->step() > 0;
  }));
  set("paused", "true");
  ASSERT_TRUE(until([&] { return stats()->paused(); }));
  const std::uint64_t step = stats()->step();
  set("pair_visibility", "true");
  set("paused", "false");
  const std::vector<std::uint8_t> seen(kPageLanes, 255);
  EXPECT_TRUE(until([&] {
    publish_visibility(seen, published()->generation(), 7);
    return stats()->step() > step;
  }));
}

/// Light ids that are no list of a scene's rows are refused, and a view waits until those of all its lights are there.
TEST_F(TrainerTest, AViewWaitsForTheVisibilityOfAllItsLights) {
  set("pair_visibility", "true");
  start();
  insert(sample_batch(0, 1, 40));
  const SyntheticScene scene(20, 1);
  TrainingView view = *scene.views()[0];
  view.scene.version = 7;
  view.scene.light.sources = {{.id = 4}, {.id = 9}};
  const std::vector<std::uint8_t> seen(3 * std::size_t{kPageLanes}, 255);
  std::vector<std::uint32_t> too_many(34);
  std::iota(too_many.begin(), too_many.end(), 0U);
  const std::uint64_t generation = published()->generation();
  ASSERT_TRUE(until([&] {
    publish_view(view);
    for (const std::vector<std::uint32_t>& ids :
         {std::vector<std::uint32_t>{}, {4, 9}, {0, 9, 4}, {0, 4, 4}, {0, 4}, {0, 4, 8}, too_many}) {
      publish_visibility(seen, generation, 7, ids);
    }
    return stats() != nullptr && stats()->unpaired_views() > 1;
  }));
  EXPECT_EQ(stats()->step(), 0U);
  ASSERT_TRUE(until([&] {
    publish_visibility(seen, generation, 7, {0, 4, 9});
    return stats()->step() > 0;
  }));
}

TEST_F(TrainerTest, StatsSayWhatRests) {
  const SyntheticScene scene;
  set("freeze_after_s", "0");
  set("freeze_gain", "1");
  set("freeze_movement", "10");
  set("thaw_rise", "100");
  start();
  insert(scene.perturbed());
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->pages_frozen() > 0; }));
  EXPECT_EQ(stats()->gaussians(), 300U);
  EXPECT_EQ(stats()->frozen(), 300U);
  EXPECT_EQ(stats()->active(), 0U);
  EXPECT_EQ(stats()->pages_frozen(), 1U);
  EXPECT_EQ(stats()->pages_active(), 0U);
  EXPECT_LT(stats()->masked_share(), 1e-3F);
  const std::uint64_t frozen_bytes = stats()->device_bytes();
  const auto model = read_model();
  ASSERT_TRUE(model);
  EXPECT_EQ(model->count(), 300U) << "readers find them as before";
  set("freeze", "false");
  EXPECT_TRUE(until([&] { return stats()->pages_active() == 1 && stats()->frozen() == 0; }));
  EXPECT_EQ(stats()->device_bytes() - frozen_bytes, (std::uint64_t{kPageLanes} * 2 * 41 - 41) * sizeof(float))
      << "the moments of a page";
}

/// Whether or not pictures carve, which need depth for it too.
TEST_F(TrainerTest, StatsSayHowMuchNothingModels) {
  const SyntheticScene scene;
  SampleBatch half = scene.perturbed();
  set("carve", "false");
  for (std::size_t i = 0; i < half.count; ++i) {
    if (half.mean[i] > 0) half.opacity_logit[i] = -20;  // x
  }
  start();
  insert(half);
  show(scene);
  EXPECT_TRUE(until([&] { return stats()->masked_share() > 0.05F; }));
  set("mask_opacity", "0");
  EXPECT_TRUE(until([&] { return stats()->masked_share() < 1e-6F; }));
}

TEST_F(TrainerTest, PicturesThatTakeMoreThanAllMayAreRefused) {
  const SyntheticScene scene(20, 1);
  bus::Subscriber subscriber(connect("reader"), {"capture/reference"});
  bus_test::meet(publisher_, subscriber);
  publish_view(*scene.views()[0]);
  const auto message = subscriber.receive(bus_test::patience);
  ASSERT_TRUE(message);
  std::atomic<std::uint64_t> host_bytes{0};
  const std::size_t bytes = scene.views()[0]->color.bytes() + scene.views()[0]->albedo.bytes();
  const std::size_t pixels = bytes / 8;
  ReferenceReader few_bytes(Device::Cpu, pixels, bytes - 1, host_bytes);
  EXPECT_THROW(static_cast<void>(few_bytes.read(*message, false)), bus::Error);
  ReferenceReader few_pixels(Device::Cpu, pixels - 1, bytes, host_bytes);
  EXPECT_THROW(static_cast<void>(few_pixels.read(*message, false)), bus::Error);
  ReferenceReader enough(Device::Cpu, pixels, bytes, host_bytes);
  EXPECT_NE(enough.read(*message, false).view, nullptr);
}

/// Does what the true one does, and fails at a step.
class FailingStep final : public GradientStep {
 public:
  FailingStep(model::PageStore& store, const Options& options, std::uint64_t at_step)
      : store_(store), true_(make_gradient_step(store, options)), at_step_(at_step) {}
  void set_options(Options& options) override { true_->set_options(options); }
  void step(std::span<const PairedView> views) override {
    if (store_.step() >= at_step_) throw std::bad_alloc();
    true_->step(views);
  }
  StepReport finished(bool wait) override { return true_->finished(wait); }
  void follow(std::span<const IndexRange> fresh, const model::Moves& moves) override { true_->follow(fresh, moves); }
  [[nodiscard]] kernels::ScreenStatistics statistics() const override { return true_->statistics(); }
  void clear_statistics() override { true_->clear_statistics(); }
  [[nodiscard]] raster::PageMoments moments_of(std::uint32_t page) const override { return true_->moments_of(page); }
  void save_moments(std::uint32_t page, float* moments) const override { true_->save_moments(page, moments); }
  void restore_moments(std::uint32_t page, raster::PageMoments kind, const float* moments) override {
    true_->restore_moments(page, kind, moments);
  }
  [[nodiscard]] device::StreamView stream() const override { return true_->stream(); }

 private:
  model::PageStore& store_;
  std::unique_ptr<GradientStep> true_;
  std::uint64_t at_step_;
};

TEST_F(TrainerTest, AFailureEndsItAndTheNextOneAdoptsTheModel) {
  const SyntheticScene scene;
  set("run_until", "20");
  start([](model::PageStore& store, const Options& options) {
    return std::make_unique<FailingStep>(store, options, 10);
  });
  insert(scene.perturbed());
  for (const auto& view : scene.views()) publish_view(*view);
  join();
  ASSERT_NE(ended_with_, nullptr);
  EXPECT_THROW(std::rethrow_exception(ended_with_), std::bad_alloc);

  newest_.clear();
  start();
  ASSERT_TRUE(until([&] { return published()->header()->epoch() == service_->bus->epoch(); }));
  EXPECT_EQ(published()->count(), 300U);
  EXPECT_EQ(published()->step(), 10U);
  EXPECT_TRUE(holds(scene.truth().batch));
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->step() == 20 && stats()->paused(); }));
}

TEST_F(TrainerTest, MemoryThatIsNotThereIsNoFaultOfTheMessage) {
  try {
    (void)bus::allocate_memory(Device::Cuda, 1);
    GTEST_SKIP() << "this machine has such memory";
  } catch (const bus::Error&) {  // as it should be
  }
  const SyntheticScene scene(20, 1);
  bus::Subscriber subscriber(connect("reader"), {"capture/reference"});
  bus_test::meet(publisher_, subscriber);
  publish_view(*scene.views()[0]);
  const auto message = subscriber.receive(bus_test::patience);
  ASSERT_TRUE(message);
  std::atomic<std::uint64_t> host_bytes{0};
  ReferenceReader reader(Device::Cuda, 1 << 20, 1 << 20, host_bytes);
  EXPECT_THROW(static_cast<void>(reader.read(*message, false)), MemoryFailure);
}

TEST_F(TrainerTest, OnlyAFailureOfMemoryPassesTheGuardOfAMessage) {
  bus::Subscriber subscriber(connect("reader"), {"model/insert"});
  bus_test::meet(publisher_, subscriber);
  publish_insert(sample_batch(0, 1, 1));
  const auto message = subscriber.receive(bus_test::patience);
  ASSERT_TRUE(message);
  EXPECT_NO_THROW(bus::guarded(*message, [] { throw std::runtime_error("it lies"); }));
  const auto allocate = [] { in_own_memory([] { throw bus::Error("there is no memory"); }); };
  EXPECT_THROW(bus::guarded(*message, allocate), MemoryFailure);
}

TEST_F(TrainerTest, GoesOnAfterARestart) {
  const SyntheticScene scene;
  set("run_until", "10");
  start();
  insert(scene.perturbed());
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->step() == 10; }));
  const auto generation = published()->generation();
  stop();
  set("run_until", "20");
  start();
  ASSERT_TRUE(until([&] { return published()->generation() > generation; }));
  EXPECT_EQ(published()->count(), 300U);
  EXPECT_EQ(published()->step(), 10U);
  EXPECT_TRUE(holds(scene.truth().batch));
  show(scene);
  ASSERT_TRUE(until([&] { return stats()->step() == 20 && stats()->paused(); }));
}

}  // namespace
}  // namespace splatbus::trainer
