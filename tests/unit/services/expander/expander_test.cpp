#include "expander/expander.h"

#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <set>

#include "../../bus/bus_fixture.h"
#include "expander/parameters.h"
#include "gaussians/model.h"
#include "sample_scene.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"

namespace splatbus::expander {
namespace {

using namespace std::chrono_literals;

/// Says model/published as a trainer would: a slab with the planes of the Gaussians that it took.
class FakeTrainer {
 public:
  explicit FakeTrainer(std::shared_ptr<bus::Context> context)
      : context_(std::move(context)),
        subscriber_(context_, {"model/insert"}),
        publisher_(context_, "model/published"),
        ring_(context_, "model", 4) {}

  /// Takes batches in; acknowledges them unless told not to.
  void serve() {
    while (auto message = subscriber_.receive(0ms)) {
      ++received;
      const auto& insert = message->root<wire::ModelInsert>("ModelInsert/1");
      const auto mean = message->tensor("mean", bus::ElementType::F32, {3, 0});
      if (!mean || deaf) continue;
      const std::uint32_t n = mean->dim(1);
      for (const char* name : {"log_scale", "albedo", "normal"})
        EXPECT_TRUE(message->tensor(name, bus::ElementType::F32, {3, n}));
      EXPECT_TRUE(message->tensor("rotation", bus::ElementType::F32, {4, n}));
      for (const char* name : {"opacity_logit", "visibility"})
        EXPECT_TRUE(message->tensor(name, bus::ElementType::F32, {1, n}));
      if (message->header().epoch() == insert_epoch && batches.contains(insert.batch())) continue;
      if (message->header().epoch() != insert_epoch) batches.clear();
      insert_epoch = message->header().epoch();
      batches.insert(insert.batch());
      const auto cells = message->tensor("cell", bus::ElementType::U64, {n})->as<std::uint64_t>();
      const auto ids = message->tensor("object_id", bus::ElementType::U32, {n})->as<std::uint32_t>();
      for (std::uint32_t i = 0; i < n; ++i) {
        const auto planes = mean->as<float>();
        points.emplace_back(planes[i], planes[n + i], planes[2 * n + i]);
        cell.push_back(cells[i]);
        object_id.push_back(ids[i]);
      }
      publish();
    }
  }

  void publish() {
    ++generation;
    const auto n = static_cast<std::uint32_t>(points.size());
    const std::uint32_t capacity = n + 16;
    const std::uint32_t channels = ParameterLayout{}.channels();
    std::vector<float> parameters(std::size_t{channels} * capacity), normal(std::size_t{3} * capacity),
        surface(std::size_t{3} * capacity);
    std::vector<float> visibility(capacity);
    std::vector<std::uint32_t> ids(capacity), flags(capacity);
    std::vector<std::uint64_t> cells(capacity), gaussians(capacity);
    for (std::uint32_t i = 0; i < n; ++i) {
      normal[capacity + i] = 1;
      for (int c = 0; c < 3; ++c) surface[static_cast<std::size_t>(c) * capacity + i] = points[i][c];
      ids[i] = object_id[i];
      cells[i] = cell[i];
    }
    using bus::ElementType;
    const std::vector<bus::TensorSource> sources{
        {"parameters", {channels, capacity}, ElementType::F32, parameters.data()},
        {"average", {channels, capacity}, ElementType::F32, parameters.data()},
        {"normal", {3, capacity}, ElementType::F32, normal.data()},
        {"surface_point", {3, capacity}, ElementType::F32, surface.data()},
        {"visibility", {capacity}, ElementType::F32, visibility.data()},
        {"object_id", {capacity}, ElementType::U32, ids.data()},
        {"flags", {capacity}, ElementType::U32, flags.data()},
        {"cell", {capacity}, ElementType::U64, cells.data()},
        {"gaussian_id", {capacity}, ElementType::U64, gaussians.data()}};
    publisher_.publish({.schema = "ModelPublished/1", .latch = true, .tensors = ring_.write(sources)},
                       [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
                         const auto list =
                             builder.CreateVector(std::vector<std::uint64_t>(batches.begin(), batches.end()));
                         return wire::CreateModelPublished(builder, header, generation, n, capacity,
                                                           wire::Appearance::Transfer, 0, 0, insert_epoch, list, 0);
                       });
  }

  int received = 0;
  bool deaf = false;
  std::uint64_t generation = 0, insert_epoch = 0;
  std::set<std::uint64_t> batches;
  std::vector<glm::vec3> points;
  std::vector<std::uint64_t> cell;
  std::vector<std::uint32_t> object_id;

 private:
  std::shared_ptr<bus::Context> context_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
};

class ExpanderTest : public bus_test::BusTest {
 protected:
  ExpanderTest()
      : parameters_(parameter_specs()),
        peer_(connect("capture-bridge")),
        reader_(peer_, {"grid/state"}),
        input_(peer_, "capture/input"),
        ring_(peer_, "input", 8, 1 << 20),
        trainer_(std::make_unique<FakeTrainer>(connect("trainer"))) {
    set("batch_size", "500");
    set("resend_s", "0.05");
    trainer_->publish();
  }

  void set(const std::string& name, const std::string& value) { ASSERT_EQ(parameters_.set(name, value, true), ""); }

  /// Starts an expander that hears what is published from now on.
  void start() {
    expander_ = std::make_unique<Expander>(connect("expander"), parameters_);
    ASSERT_TRUE(until([&] { return expander_->follower().settled() && state_.has_value() && rounds() == 0; }));
  }

  bool until(const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      if (expander_) expander_->step(1ms);
      if (trainer_) trainer_->serve();
      while (auto message = reader_.receive(0ms)) state_ = *message;
      return condition();
    });
  }

  const wire::GridState& state() { return state_->root<wire::GridState>("GridState/1"); }
  std::uint64_t rounds() { return state().rounds(); }
  /// The state that eval waits for.
  bool settled_after(std::uint64_t round_count) {
    return until([&] { return state_ && rounds() >= round_count && state().batches_pending() == 0; });
  }

  void publish_input(const InputSamples& samples) {
    using bus::ElementType;
    const auto n = static_cast<std::uint32_t>(samples.size());
    const auto c = static_cast<std::uint32_t>(samples.cameras.size());
    const std::vector<bus::TensorSource> sources{
        {"position", {n, 3}, ElementType::F32, samples.position.data()},
        {"normal", {n, 3}, ElementType::F32, samples.normal.data()},
        {"albedo", {n, 3}, ElementType::F32, samples.albedo.data()},
        {"color", {n, 3}, ElementType::F32, samples.color.data()},
        {"spacing", {n}, ElementType::F32, samples.spacing_m.data()},
        {"cosine", {n}, ElementType::F32, samples.cosine.data()},
        {"object_id", {n}, ElementType::U32, samples.object_id.data()},
        {"camera", {n}, ElementType::U32, samples.camera.data()},
        {"depth", {c, samples.height, samples.width}, ElementType::F32, samples.depth_m.data()}};
    input_.publish({.schema = "CaptureInput/1", .tensors = ring_.write(sources)},
                   [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
                     std::vector<wire::Camera> cameras;
                     for (const Camera& camera : samples.cameras) cameras.push_back(to_wire(camera));
                     const auto cameras_offset = builder.CreateVectorOfStructs(cameras);
                     const auto objects = to_wire(builder, samples.objects);
                     const auto light = to_wire(builder, samples.light);
                     return wire::CreateCaptureInput(builder, header, 1, 0, samples.rig_generation, cameras_offset,
                                                     objects, light);
                   });
  }

  [[nodiscard]] std::size_t distinct_points() const {
    std::set<std::tuple<float, float, float>> distinct;
    for (const glm::vec3& p : trainer_->points) distinct.insert({p.x, p.y, p.z});
    return distinct.size();
  }

  bus::Parameters parameters_;
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber reader_;
  bus::Publisher input_;
  bus::TensorRing ring_;
  std::unique_ptr<FakeTrainer> trainer_;
  std::unique_ptr<Expander> expander_;
  std::optional<bus::Message> state_;
};

TEST_F(ExpanderTest, InsertsARoundOnceInBoundedBatches) {
  start();
  const InputSamples round = test::floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), round.size());
  EXPECT_EQ(distinct_points(), round.size());
  EXPECT_EQ(trainer_->batches.size(), (round.size() + 499) / 500);
  EXPECT_EQ(state().gaussians_inserted(), round.size());
  EXPECT_EQ(state().cells_seen(), state().cells_modelled());
  EXPECT_EQ(state().cells()->size(), state().cells_modelled());
  publish_input(round);
  ASSERT_TRUE(settled_after(2));
  EXPECT_EQ(trainer_->points.size(), round.size());
}

TEST_F(ExpanderTest, RepeatsWhatIsNotAcknowledged) {
  start();
  trainer_->deaf = true;
  publish_input(test::floor_round(-1, 1));
  ASSERT_TRUE(until([&] { return trainer_->received >= 12; })) << "4 batches, three times";
  EXPECT_EQ(expander_->ledger().pending(), 4U);
  trainer_->deaf = false;
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 1600U);
}

TEST_F(ExpanderTest, ARestartedExpanderDoesNotDoubleTheModel) {
  start();
  const InputSamples round = test::floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(settled_after(1));
  expander_.reset();
  start();
  EXPECT_EQ(expander_->follower().adoptions(), 1U);
  EXPECT_EQ(expander_->mapper().modelled_points(), round.size());
  publish_input(test::floor_round(-1, 1.5F));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 2500U);
  EXPECT_EQ(distinct_points(), 2500U);
}

TEST_F(ExpanderTest, ATrainerThatLostItsModelGetsItAgain) {
  start();
  publish_input(test::floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  trainer_ = std::make_unique<FakeTrainer>(connect("trainer"));
  trainer_->publish();
  ASSERT_TRUE(until([&] { return trainer_->points.size() == 1600; }));
  ASSERT_TRUE(until([&] { return state().batches_pending() == 0; }));
  EXPECT_EQ(distinct_points(), 1600U);
}

TEST_F(ExpanderTest, WaitsForTheTrainerToSayWhatItHas) {
  trainer_.reset();
  expander_ = std::make_unique<Expander>(connect("another-bus-name"), parameters_);
  // The broker holds what the first trainer said: the expander is settled by it without any trainer alive.
  ASSERT_TRUE(until([&] { return expander_->follower().settled(); }));
}

TEST_F(ExpanderTest, BrokenInputIsRefusedAndNothingElseDisturbed) {
  start();
  InputSamples nan = test::floor_round(-1, 0);
  for (auto& position : nan.position) position.x = std::numeric_limits<float>::quiet_NaN();
  publish_input(nan);
  InputSamples cameras = test::floor_round(-1, 0);
  cameras.cameras.push_back(cameras.cameras[0]);
  cameras.depth_m.resize(cameras.depth_m.size() * 2);
  for (auto& index : cameras.camera) index = 7;
  publish_input(cameras);
  // A wrong schema; tensors that disagree; no tensors at all.
  input_.publish({.schema = "ViewerPose/1"}, [&](auto& builder, auto header) {
    return wire::CreateCaptureInput(builder, header, 0, 0, 0, 0, 0, to_wire(builder, Light{}));
  });
  input_.publish({.schema = "CaptureInput/1"}, [&](auto& builder, auto header) {
    return wire::CreateCaptureInput(builder, header, 0, 0, 0, 0, 0, to_wire(builder, Light{}));
  });
  const std::vector<float> few(30);
  const std::vector<bus::OutgoingTensor> lying{{.name = "position", .shape = {10, 3}, .inline_data = few.data()}};
  input_.publish({.schema = "CaptureInput/1", .tensors = lying}, [&](auto& builder, auto header) {
    return wire::CreateCaptureInput(builder, header, 0, 0, 0, 0, 0, to_wire(builder, Light{}));
  });
  bus::Publisher published(peer_, "model/published");
  published.publish({.schema = "ModelPublished/1"}, [&](auto& builder, auto header) {
    return wire::CreateModelPublished(builder, header, 5, 1000, 2000);
  });
  const InputSamples round = test::floor_round(-1, 1);
  publish_input(round);
  ASSERT_TRUE(until([&] { return trainer_->points.size() == round.size(); }));
  EXPECT_EQ(expander_->counters().samples_dropped, nan.size() + cameras.size());
}

TEST_F(ExpanderTest, StopsAtTheMostGaussians) {
  set("max_gaussians", "700");
  start();
  publish_input(test::floor_round(-1, 1));
  ASSERT_TRUE(settled_after(1));
  EXPECT_EQ(trainer_->points.size(), 700U);
}

}  // namespace
}  // namespace splatbus::expander
