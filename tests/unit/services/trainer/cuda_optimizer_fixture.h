#pragma once

#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bus/error.h"
#include "cuda_model_fixture.h"
#include "synthetic_scene.h"
#include "trainer/optimizer.h"
#include "trainer/view_sampler.h"

namespace splatbus::trainer {

template <class T>
Pixels<T> placed(const Pixels<T>& pixels, Device memory) {
  if (pixels.empty()) return {};
  auto copy = bus::allocate_memory(memory, pixels.bytes());
  bus::copy_memory(copy.get(), memory, pixels.data(), Device::Cpu, pixels.bytes());
  bus::finish_copies();
  return {std::shared_ptr<const T>(copy, reinterpret_cast<const T*>(copy.get())), pixels.size()};
}

inline TrainingViewPtr placed(const TrainingView& view, Device memory) {
  TrainingView copy = view;
  copy.memory = memory;
  copy.color = placed(view.color, memory);
  copy.albedo = placed(view.albedo, memory);
  copy.depth = placed(view.depth, memory);
  return std::make_shared<const TrainingView>(std::move(copy));
}

using Settings = std::vector<std::pair<std::string, std::string>>;

/// A model of its own in one kind of memory, trained on the synthetic scene.
class Trial {
 public:
  Trial(std::shared_ptr<bus::Context> context, Device memory, const SyntheticScene& scene, const Settings& settings,
        std::size_t capacity = 512)
      : Trial(std::move(context), memory, scene.perturbed(), settings, capacity) {
    for (const auto& view : scene.views()) put(*view);
  }

  /// Without views.
  Trial(std::shared_ptr<bus::Context> context, Device memory, InsertBatch batch, const Settings& settings,
        std::size_t capacity = 512)
      : context_(std::move(context)) {
    EXPECT_EQ(parameters_.set("input_view_interval", "0", true), "");
    EXPECT_EQ(parameters_.set("threads", "1", false), "");
    EXPECT_EQ(parameters_.set("batch", "1", true), "");
    EXPECT_EQ(parameters_.set("ema_s", "0", true), "");                 // it depends on the pace
    EXPECT_EQ(parameters_.set("lr_half_life_steps", "200", true), "");  // each backend has one of its own
    for (const auto& [name, value] : settings) EXPECT_EQ(parameters_.set(name, value, false), "");
    const Options options = parameters_.read<Options>();
    store_ = std::make_unique<ModelStore>(context_, options.layout, capacity, 4096, memory);
    optimizer_ = make_optimizer(*store_, options);
    insert(std::move(batch));
  }

  void insert(InsertBatch batch) {
    Commands commands;
    commands.inserts.push_back(std::move(batch));
    optimizer_->apply(commands);
  }

  /// Mean loss of the steps, all of them at their end.
  double train(int steps) {
    StepReport sum;
    for (int i = 0; i < steps; ++i) {
      sum += optimizer_->step(sampler_.next_batch(views_, optimizer_->options().batch, 0));
    }
    sum += optimizer_->finish();
    EXPECT_EQ(sum.steps, static_cast<std::size_t>(steps));
    seconds_ += sum.seconds;
    return sum.loss;
  }

  /// One step of these views.
  StepReport step(const std::vector<const TrainingView*>& views) {
    std::vector<TrainingViewPtr> batch;
    batch.reserve(views.size());
    for (const TrainingView* view : views) batch.push_back(placed(*view, store_->memory()));
    return optimizer_->step(batch);
  }

  void set(const std::string& name, const std::string& value) {
    EXPECT_EQ(parameters_.set(name, value, true), "");
    optimizer_->set_options(parameters_.read<Options>());
  }

  void put(const TrainingView& view) { views_.put(placed(view, store_->memory())); }

  /// Writes one value of a plane of parameters.
  void poke(int channel, std::size_t column, float value) {
    float* const to = store_->planes().parameters + static_cast<std::size_t>(channel) * store_->capacity() + column;
    bus::copy_memory(to, store_->memory(), &value, Device::Cpu, sizeof(value));
    bus::finish_copies();
  }

  [[nodiscard]] HostPlanes planes() const { return HostPlanes(*store_); }
  [[nodiscard]] ModelStore& store() { return *store_; }
  [[nodiscard]] Optimizer& optimizer() { return *optimizer_; }
  [[nodiscard]] double seconds() const { return seconds_; }

 private:
  std::shared_ptr<bus::Context> context_;
  bus::Parameters parameters_{bus::Parameters::declare<Options>()};
  ViewStore views_;
  ViewSampler sampler_{1};
  std::unique_ptr<ModelStore> store_;
  std::unique_ptr<Optimizer> optimizer_;
  double seconds_ = 0;
};

/// Relative, over the first `channels` planes.
inline double distance(const float* a, std::size_t a_stride, const float* b, std::size_t b_stride, std::size_t count,
                       int channels) {
  double off = 0;
  double norm = 0;
  for (std::size_t c = 0; c < static_cast<std::size_t>(channels); ++c) {
    for (std::size_t i = 0; i < count; ++i) {
      const double left = a[c * a_stride + i];
      const double right = b[c * b_stride + i];
      off += (left - right) * (left - right);
      norm += right * right;
    }
  }
  return std::sqrt(off / norm);
}

class CudaOptimizerTest : public bus_test::BusTest {
 protected:
  void SetUp() override {
    if (!has_device()) GTEST_SKIP() << "no CUDA device";
    bus_test::BusTest::SetUp();
  }

  Trial trial(Device memory, const Settings& settings = {}, std::size_t capacity = 512) {
    // A name of its own: a second trial must not adopt the first one's model.
    const std::string name = "trainer-" + std::to_string(++trials_);
    return {connect(name), memory, scene_, settings, capacity};
  }

  static void expect_close(Trial& cuda, Trial& cpu, double tolerance) {
    const HostPlanes a = cuda.planes();
    const HostPlanes b = cpu.planes();
    ASSERT_EQ(a.count(), b.count());
    EXPECT_EQ(a.ids(), b.ids());
    const int channels = ParameterLayout::kResidual;
    EXPECT_LT(distance(a->parameters, a->capacity, b->parameters, b->capacity, a.count(), channels), tolerance);
    EXPECT_LT(distance(a->average, a->capacity, b->average, b->capacity, a.count(), channels), tolerance);
  }

  [[nodiscard]] double psnr(Trial& trial, bool average) const {
    const HostPlanes planes = trial.planes();
    GaussiansView view = planes->view(planes.count());
    if (average) view.parameters = planes->average;
    return scene_.psnr(view);
  }

  // Small: a step takes a second when every access to shared memory is checked.
  SyntheticScene scene_{100, 4, 32};
  int trials_ = 0;
};

}  // namespace splatbus::trainer
