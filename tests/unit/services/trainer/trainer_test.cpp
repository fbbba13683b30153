#include "trainer/trainer.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <thread>

#include "../../bus/bus_fixture.h"
#include "bus/tensor_ring.h"
#include "synthetic_scene.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/published_model.h"

namespace splatbus::trainer {
namespace {

using namespace std::chrono_literals;

/// A trainer on a bus, with an expander, a capture bridge and a relight made by hand.
class TrainerTest : public bus_test::BusTest {
 protected:
  TrainerTest()
      : peer_(connect("peer")),
        subscriber_(peer_, {"model/published", "trainer/stats", "trainer/cells"}),
        insert_(peer_, "model/insert"),
        reference_(peer_, "capture/reference"),
        freeze_(peer_, "model/freeze"),
        unfreeze_(peer_, "model/unfreeze"),
        visibility_(peer_, "relight/visibility"),
        ring_(peer_, "pictures", 32) {
    set("threads", "1", false);
    set("capacity", "1024", false);
    set("input_view_interval", "0", false);
  }

  ~TrainerTest() override { stop(); }

  void set(const std::string& name, const std::string& value, bool at_runtime = true) {
    EXPECT_EQ(parameters_.set(name, value, at_runtime), "");
  }

  void start() {
    stop_ = std::stop_source();
    service_ = std::make_unique<bus::ServiceContext>(connect("trainer"), parameters_, stop_.get_token());
    thread_ = std::thread([this] { Trainer(*service_).run(); });
    ASSERT_TRUE(until([&] { return published(); }));
  }

  void stop() {
    stop_.request_stop();
    if (thread_.joinable()) thread_.join();
    service_.reset();
    newest_.clear();
  }

  /// Receives until the condition holds.
  bool until(const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      while (auto message = subscriber_.receive(5ms)) newest_.insert_or_assign(message->topic(), *message);
      return condition();
    });
  }

  const wire::ModelPublished* published() {
    const auto found = newest_.find("model/published");
    return found == newest_.end() ? nullptr : &found->second.root<wire::ModelPublished>("ModelPublished/1");
  }
  const wire::TrainerStats* stats() {
    const auto found = newest_.find("trainer/stats");
    return found == newest_.end() ? nullptr : &found->second.root<wire::TrainerStats>("TrainerStats/1");
  }
  bool holds(std::uint64_t batch) {
    const auto* model = published();
    if (model == nullptr || model->insert_epoch() != peer_->epoch()) return false;
    const auto* batches = model->inserted_batches();
    return std::find(batches->begin(), batches->end(), batch) != batches->end();
  }

  void publish_insert(const InsertBatch& batch, const std::string& without = {}) {
    const auto n = static_cast<std::uint32_t>(batch.count);
    const auto u32 = bus::ElementType::U32;
    const auto u64 = bus::ElementType::U64;
    std::vector<bus::TensorSource> sources = {
        {.name = "mean", .shape = {3, n}, .data = batch.mean.data()},
        {.name = "log_scale", .shape = {3, n}, .data = batch.log_scale.data()},
        {.name = "rotation", .shape = {4, n}, .data = batch.rotation.data()},
        {.name = "opacity_logit", .shape = {1, n}, .data = batch.opacity_logit.data()},
        {.name = "albedo", .shape = {3, n}, .data = batch.albedo.data()},
        {.name = "normal", .shape = {3, n}, .data = batch.normal.data()},
        {.name = "visibility", .shape = {1, n}, .data = batch.visibility.data()},
        {.name = "object_id", .shape = {n}, .type = u32, .data = batch.object_id.data()},
        {.name = "cell", .shape = {n}, .type = u64, .data = batch.cell.data()}};
    std::erase_if(sources, [&](const bus::TensorSource& source) { return source.name == without; });
    insert_.publish({.schema = "ModelInsert/1", .tensors = ring_.write(sources)}, [&](auto& builder, auto header) {
      const auto light = to_wire(builder, batch.light);
      return wire::CreateModelInsert(builder, header, batch.batch, 0, light);
    });
  }

  void insert(const InsertBatch& batch) {
    ASSERT_TRUE(until([&] {
      publish_insert(batch);  // as the expander does, until it is acknowledged
      return holds(batch.batch);
    }));
  }

  void publish_view(const TrainingView& view, bool retire = false, std::uint32_t height_off = 0) {
    const std::uint32_t h = view.camera.height + height_off;
    const std::uint32_t w = view.camera.width;
    std::vector<bus::TensorSource> sources;
    if (!retire && height_off == 0) {
      sources = {{.name = "color", .shape = {h, w, 4}, .type = bus::ElementType::U8, .data = view.color.data()},
                 {.name = "albedo", .shape = {h, w, 4}, .type = bus::ElementType::U8, .data = view.albedo.data()}};
    } else if (!retire) {
      sources = {{.name = "color",
                  .shape = {h - 2 * height_off, w, 4},
                  .type = bus::ElementType::U8,
                  .data = view.color.data()}};
    }
    bus::MessageInfo info{.schema = "CaptureReference/1"};
    if (!sources.empty()) info.tensors = ring_.write(sources);
    reference_.publish(info, [&](auto& builder, auto header) {
      const auto light = to_wire(builder, view.scene.light);
      const auto camera = to_wire(view.camera);
      return wire::CreateCaptureReference(builder, header, 1, 0.0, &camera, 0, light, retire);
    });
  }

  void show(const SyntheticScene& scene) {
    ASSERT_TRUE(until([&] {
      for (const auto& view : scene.views()) publish_view(*view);
      return stats() != nullptr && stats()->ready_references() == scene.views().size();
    }));
  }

  bus::Parameters parameters_{parameter_specs()};
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber subscriber_;
  bus::Publisher insert_, reference_, freeze_, unfreeze_, visibility_;
  bus::TensorRing ring_;
  std::stop_source stop_;
  std::unique_ptr<bus::ServiceContext> service_;
  std::thread thread_;
  std::map<std::string, bus::Message> newest_;
};

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
  const auto model = PublishedModel::open(newest_.at("model/published"));
  ASSERT_TRUE(model);
  const double psnr = scene.psnr(model->average());

  set("run_until", "120");
  ASSERT_TRUE(until([&] { return stats()->step() == 120 && stats()->paused(); }));
  EXPECT_GT(scene.psnr(model->average()), psnr + 1) << "the model is read live";
  ASSERT_TRUE(until([&] { return newest_.contains("trainer/cells"); }));
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
  const InsertBatch batch = sample_batch(0, 7, 50);
  insert(batch);
  for (int i = 0; i < 5; ++i) publish_insert(batch);
  insert(sample_batch(0, 8, 20));
  EXPECT_EQ(published()->count(), 70U);
}

TEST_F(TrainerTest, BadInsertsHarmNobody) {
  start();
  insert(sample_batch(0, 1, 10));
  InsertBatch damaged = sample_batch(0, 2, 10);
  damaged.mean[4] = std::numeric_limits<float>::quiet_NaN();
  publish_insert(sample_batch(0, 3, 10), "albedo");  // a plane is missing
  InsertBatch short_plane = sample_batch(0, 4, 10);
  insert_.publish({.schema = "ModelInsert/2"}, [&](auto& builder, auto header) {
    const auto light = to_wire(builder, Light{});
    return wire::CreateModelInsert(builder, header, 5, 0, light);
  });
  insert_.publish({.schema = "ModelInsert/1"}, [&](auto& builder, auto header) {
    return wire::CreateTrainerCells(builder, header, 6);  // another table under that name
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

TEST_F(TrainerTest, FreezesThawsAndTakesVisibility) {
  start();
  const InsertBatch batch = sample_batch(0, 1, 40);
  insert(batch);
  std::uint64_t in_cell = 0;
  for (const auto cell : batch.cell) in_cell += cell == 1 ? 1 : 0;
  const std::vector<std::uint64_t> cells{1};
  const auto send = [&](bus::Publisher& publisher) {
    publisher.publish({.schema = "ModelCells/1"}, [&](auto& builder, auto header) {
      return wire::CreateModelCells(builder, header, builder.CreateVector(cells));
    });
  };
  ASSERT_TRUE(until([&] {
    send(freeze_);
    return published()->frozen() == in_cell;
  }));
  ASSERT_TRUE(until([&] {
    send(unfreeze_);
    return published()->frozen() == 0;
  }));

  std::vector<float> seen(40, 0.25F);
  seen[1] = std::numeric_limits<float>::quiet_NaN();
  seen[2] = 7.0F;
  std::optional<PublishedModel> model;
  ASSERT_TRUE(until([&] {
    const bus::TensorSource source{.name = "visibility", .shape = {1, 40}, .data = seen.data()};
    visibility_.publish({.schema = "RelightVisibility/1", .tensors = ring_.write({&source, 1})},
                        [&](auto& builder, auto header) {
                          return wire::CreateRelightVisibility(builder, header, published()->generation(), 1, 40);
                        });
    model = PublishedModel::open(newest_.at("model/published"));
    return model && model->live().visibility[0] == 0.25F;
  }));
  EXPECT_EQ(model->live().visibility[1], 0.0F);
  EXPECT_EQ(model->live().visibility[2], 1.0F);
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
