#pragma once

#include <gtest/gtest.h>

#include <map>
#include <set>
#include <string>
#include <tuple>

#include "../../bus/bus_fixture.h"
#include "../../model/paged_publisher.h"
#include "bus/error.h"
#include "bus/memory.h"
#include "bus/tensor_ring.h"
#include "expander/expander.h"
#include "expander/parameters.h"
#include "gaussians/model.h"
#include "sample_scene.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"

namespace splatbus::expander::test {

using namespace std::chrono_literals;

template <class T>
std::vector<T> host_copy(const bus::TensorView& tensor) {
  std::vector<T> values(tensor.elements());
  std::atomic<std::uint64_t> bytes{0};
  EXPECT_TRUE(bus::copy_tensor(tensor, values.data(), Device::Cpu, bytes));
  return values;
}

/// Where the expander works, and where its peers keep what they publish.
struct Machine {
  Device backend;
  Device peers;
};

inline std::string machine_name(const testing::TestParamInfo<Machine>& info) {
  return std::string(name_of(info.param.backend)) + "_among_" + (info.param.peers == Device::Cuda ? "cuda" : "cpu");
}

/// Says model/published as a trainer would: pages of the Gaussians that it took.
class FakeTrainer {
 public:
  FakeTrainer(std::shared_ptr<bus::Context> context, Device memory)
      : context_(std::move(context)),
        subscriber_(context_, {"model/insert"}),
        publisher_(context_),
        pages_(context_, memory) {
    pages_.keeps_generations = true;
  }

  /// Takes batches in; acknowledges them unless told not to.
  void serve() {
    while (auto message = subscriber_.receive(0ms)) {
      ++received;
      const auto& insert = message->root<wire::ModelInsert>();
      const auto mean = message->tensor("mean", bus::ElementType::F32, {3, 0});
      if (!mean || deaf) continue;
      const std::uint32_t n = mean->dim(1);
      const auto normals = host_copy<float>(message->tensor("normal", bus::ElementType::F32, {3, n}).value());
      for (const char* name : {"log_scale", "albedo"})
        EXPECT_TRUE(message->tensor(name, bus::ElementType::F32, {3, n}));
      EXPECT_TRUE(message->tensor("rotation", bus::ElementType::F32, {4, n}));
      for (const char* name : {"opacity_logit", "visibility"})
        EXPECT_TRUE(message->tensor(name, bus::ElementType::F32, {1, n}));
      if (message->header().epoch() == insert_epoch && batches.contains(insert.batch())) continue;
      if (message->header().epoch() != insert_epoch) batches.clear();
      insert_epoch = message->header().epoch();
      batches.insert(insert.batch());
      const auto ids = host_copy<std::uint32_t>(message->tensor("object_id", bus::ElementType::U32, {n}).value());
      const auto planes = host_copy<float>(*mean);
      for (std::uint32_t i = 0; i < n; ++i) {
        points.emplace_back(planes[i], planes[n + i], planes[2 * n + i]);
        normal.emplace_back(normals[i], normals[n + i], normals[2 * n + i]);
        object_id.push_back(ids[i]);
      }
      publish();
    }
  }

  void publish() {
    ++generation;
    GaussiansBuffer model(ParameterLayout{}, points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      for (int c = 0; c < 3; ++c) {
        model.surface_point[static_cast<std::size_t>(c) * model.stride() + i] = points[i][c];
        model.normal[static_cast<std::size_t>(c) * model.stride() + i] = normal[i][c];
      }
      model.object_id[i] = object_id[i];
    }
    pages_.publish(publisher_, model, generation, insert_epoch, {batches.begin(), batches.end()});
  }

  /// Whether the broker has its newest word; says that again as long as it has not.
  bool is_latched() {
    bus::Subscriber reader(context_, {"model/published"});
    const auto message = reader.receive(100ms);
    const bool has = message && message->header().epoch() == context_->epoch() &&
                     message->root<wire::ModelPublished>().generation() == generation;
    if (!has) publish();
    return has;
  }

  /// As pruning does: from `first` on they are gone.
  void remove_from(std::size_t first) {
    points.resize(first);
    normal.resize(first);
    object_id.resize(first);
    publish();
  }

  int received = 0;
  bool deaf = false;
  std::uint64_t generation = 0, insert_epoch = 0;
  std::set<std::uint64_t> batches;
  std::vector<glm::vec3> points, normal;
  std::vector<std::uint32_t> object_id;

 private:
  std::shared_ptr<bus::Context> context_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  model::PagedPublisher pages_;
};

/// Skipped where the machine is not to be had.
class ExpanderTest : public bus_test::BusTest, public testing::WithParamInterface<Machine> {
 protected:
  ExpanderTest()
      : parameters_(bus::Parameters::declare<Options>()),
        peer_(connect("capture-bridge")),
        reader_(peer_, {"grid/state"}),
        publisher_(peer_),
        ring_(peer_, "input", 8, 1 << 20, GetParam().peers) {
    set("batch_size", "500");
    set("resend_s", "0.05");
    set("refresh_s", "0");
  }

  void SetUp() override {
    if (GetParam().backend == Device::Cuda || GetParam().peers == Device::Cuda) {
      try {
        (void)bus::choose_backend("cuda");
      } catch (const bus::Error& error) {
        GTEST_SKIP() << error.what();
      }
    }
    start_trainer();
  }

  void start_trainer() {
    trainer_ = std::make_unique<FakeTrainer>(connect("trainer"), GetParam().peers);
    trainer_->publish();
  }

  void set(const std::string& name, const std::string& value) { ASSERT_EQ(parameters_.set(name, value, true), ""); }

  /// Starts an expander that hears what is published from now on, and first the trainer's newest word: not one before
  /// it, nor one of a trainer of the same name that has just ended.
  void start() {
    ASSERT_TRUE(until([&] { return !trainer_ || trainer_->is_latched(); }));
    expander_ = std::make_unique<Expander>(connect("expander"), parameters_, GetParam().backend);
    expander_->adopt_handover();
    ASSERT_TRUE(until([&] { return expander_->model_sync().settled() && state_.has_value() && rounds() == 0; }));
  }

  bool until(const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      if (expander_) expander_->step(1ms);
      if (trainer_) trainer_->serve();
      while (auto message = reader_.receive(0ms)) hear(*message);
      return condition();
    });
  }

  void hear(const bus::Message& message) {
    state_ = message;
    if (state().cells() == nullptr) return;
    largest_state_ = std::max<std::size_t>(largest_state_, state().cells()->size());
    for (const wire::CellState* cell : *state().cells()) {
      told_[{cell->object_id(), cell->cell()}] = {cell->samples(), cell->modelled()};
      ++cells_told_;
    }
  }

  const wire::GridState& state() { return state_->root<wire::GridState>(); }
  std::uint64_t rounds() { return state().rounds(); }
  /// The state that eval waits for.
  bool settled_after(std::uint64_t round_count) {
    return until([&] { return state_ && rounds() >= round_count && state().batches_pending() == 0; });
  }

  void publish_input(const HostRound& samples) {
    using bus::ElementType;
    const auto n = static_cast<std::uint32_t>(samples.size());
    const std::vector<bus::TensorSource> sources{{"position", {n, 3}, ElementType::F32, samples.position.data()},
                                                 {"normal", {n, 3}, ElementType::F32, samples.normal.data()},
                                                 {"albedo", {n, 3}, ElementType::F32, samples.albedo.data()},
                                                 {"color", {n, 3}, ElementType::F32, samples.color.data()},
                                                 {"spacing", {n}, ElementType::F32, samples.spacing_m.data()},
                                                 {"object_id", {n}, ElementType::U32, samples.object_id.data()}};
    publisher_.publish(topics::kCaptureInput, {.tensors = ring_.write(sources)},
                       [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
                         std::vector<wire::Camera> cameras;
                         for (const Camera& camera : samples.cameras) cameras.push_back(to_wire(camera));
                         const auto cameras_offset = builder.CreateVectorOfStructs(cameras);
                         const auto objects = to_wire(builder, samples.scene.objects);
                         const auto light = to_wire(builder, samples.scene.light);
                         return wire::CreateCaptureInput(builder, header, samples.rig_generation, cameras_offset,
                                                         wire::CreateSceneState(builder, 1, 0, objects, light));
                       });
  }

  /// The trainer removes Gaussians from `first` on, and the expander has heard of it.
  void remove_from(std::size_t first) {
    trainer_->remove_from(first);
    ASSERT_TRUE(until([&] { return expander_->model_sync().generation() == trainer_->generation; }));
  }

  [[nodiscard]] std::size_t distinct_points() const {
    std::set<std::tuple<float, float, float>> distinct;
    for (const glm::vec3& p : trainer_->points) distinct.insert({p.x, p.y, p.z});
    return distinct.size();
  }

  bus::Parameters parameters_;
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber reader_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  std::unique_ptr<FakeTrainer> trainer_;
  std::unique_ptr<Expander> expander_;
  std::optional<bus::Message> state_;
  // What all states together have said: of (object, cell), its samples and points.
  std::map<std::pair<std::uint32_t, std::uint64_t>, std::pair<std::uint32_t, std::uint32_t>> told_;
  std::size_t largest_state_ = 0, cells_told_ = 0;
};

}  // namespace splatbus::expander::test
