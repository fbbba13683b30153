#pragma once

#include <gmock/gmock.h>

#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "bus/error.h"
#include "host_model.h"
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
  copy.mask = placed(view.mask, memory);
  copy.farthest_m = placed(view.farthest_m, memory);
  return std::make_shared<const TrainingView>(std::move(copy));
}

using Settings = std::vector<std::pair<std::string, std::string>>;

/// A model of its own in one kind of memory, trained on the synthetic scene.
class Trial {
 public:
  Trial(std::shared_ptr<bus::Context> context, Device memory, const SyntheticScene& scene, const Settings& settings,
        std::size_t max_gaussians = 4096)
      : Trial(std::move(context), memory, scene.perturbed(), settings, max_gaussians) {
    for (const auto& view : scene.views()) put(*view);
  }

  /// Without views.
  Trial(std::shared_ptr<bus::Context> context, Device memory, const SampleBatch& batch, const Settings& settings,
        std::size_t max_gaussians = 4096)
      : context_(std::move(context)) {
    EXPECT_EQ(parameters_.set("input_view_interval", "0", true), "");
    EXPECT_EQ(parameters_.set("threads", "1", false), "");
    EXPECT_EQ(parameters_.set("batch", "1", true), "");
    EXPECT_EQ(parameters_.set("freeze", "false", true), "");            // as does this
    EXPECT_EQ(parameters_.set("most_size", "0", true), "");             // tests make Gaussians that are too large
    EXPECT_EQ(parameters_.set("ema_s", "0", true), "");                 // it depends on the pace
    EXPECT_EQ(parameters_.set("lr_half_life_steps", "200", true), "");  // each backend has one of its own
    for (const auto& [name, value] : settings) EXPECT_EQ(parameters_.set(name, value, false), "");
    const auto options = parameters_.read<Options>();
    store_ = std::make_unique<model::PageStore>(context_, options.layout,
                                                model::PageStoreOptions{.max_gaussians = max_gaussians}, memory);
    optimizer_ = std::make_unique<Optimizer>(*store_, options);
    insert(batch);
  }

  bool insert(const SampleBatch& batch) {
    Commands commands;
    commands.inserts.push_back(batch.on(store_->device()));
    return optimizer_->apply(commands);
  }

  /// Mean loss of the steps, all of them at their end.
  double train(int steps) {
    StepReport sum;
    for (int i = 0; i < steps; ++i) {
      sum += optimizer_->step(sampler_.next_batch(views_, optimizer_->options().batch, {}));
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
    for (const TrainingView* view : views) batch.push_back(placed(*view, store_->device()));
    return optimizer_->step(batch);
  }

  void set(const std::string& name, const std::string& value) {
    EXPECT_EQ(parameters_.set(name, value, true), "");
    optimizer_->set_options(parameters_.read<Options>());
  }

  void put(const TrainingView& view) { views_.put(placed(view, store_->device())); }

  /// Writes one parameter of Gaussian number k.
  void poke(int channel, std::size_t k, float value) {
    optimizer_->finish();
    trainer::poke(*store_, channel, model().index(k), value);
  }

  [[nodiscard]] HostModel model() const { return HostModel(*store_); }
  [[nodiscard]] model::PageStore& store() { return *store_; }
  [[nodiscard]] Optimizer& optimizer() { return *optimizer_; }
  [[nodiscard]] double seconds() const { return seconds_; }

 private:
  std::shared_ptr<bus::Context> context_;
  bus::Parameters parameters_{bus::Parameters::declare<Options>()};
  ViewStore views_;
  ViewSampler sampler_{1};
  std::unique_ptr<model::PageStore> store_;
  std::unique_ptr<Optimizer> optimizer_;
  double seconds_ = 0;
};

/// Relative, over the first `channels` channels.
inline double distance(const GaussiansView& a, const GaussiansView& b, int channels) {
  double off = 0;
  double norm = 0;
  for (int c = 0; c < channels; ++c) {
    for (std::size_t i = 0; i < a.count; ++i) {
      const double left = a.plane(c)[i];
      const double right = b.plane(c)[i];
      off += (left - right) * (left - right);
      norm += right * right;
    }
  }
  return std::sqrt(off / norm);
}

/// Trials on a bus.
class OptimizerTest : public bus_test::BusTest {
 protected:
  Trial trial(Device memory, const Settings& settings = {}, std::size_t max_gaussians = 4096) {
    // A name of its own: a second trial must not adopt the first one's model.
    const std::string name = "trainer-" + std::to_string(++trials_);
    return {connect(name), memory, scene_, settings, max_gaussians};
  }

  static void expect_close(const Trial& one, const Trial& other, double tolerance) {
    const HostModel a = one.model();
    const HostModel b = other.model();
    ASSERT_EQ(a.ids(), b.ids());
    const int channels = ParameterLayout::kResidual;
    EXPECT_LT(distance(a.live(), b.live(), channels), tolerance);
    EXPECT_LT(distance(a.average(), b.average(), channels), tolerance);
  }

  /// A view in whose scene a lamp shines trains with the lamp's own row: where no Gaussian sees it, as without it.
  void expect_rows_of_lights(Device memory) {
    TrainingView plain = *scene_.views()[0];
    plain.scene.version = 3;
    TrainingView lit = plain;
    lit.scene.light.sources = {{.id = 4, .position = {0, 3, 0}, .intensity = glm::vec3(20), .range_m = 30},
                               {.id = 9, .position = {1, 3, 0}, .intensity = glm::vec3(20), .range_m = 30}};
    const auto loss = [&](const TrainingView& view, const std::vector<std::uint8_t>& of_rows) {
      Trial one = trial(memory, {{"densify", "false"}});
      const std::size_t count = one.store().view().count;
      std::vector<std::uint8_t> rows;
      for (const std::uint8_t value : of_rows) rows.insert(rows.end(), count, value);
      const std::shared_ptr<std::byte> values = bus::allocate_memory(memory, rows.size());
      bus::copy_memory(values.get(), memory, rows.data(), Device::Cpu, rows.size());
      bus::finish_copies();
      Commands commands;
      commands.add(VisibilityCommand{.model_generation = one.store().generation(),
                                     .scene_version = 3,
                                     .count = count,
                                     .light_ids = light_ids(view.scene.light),
                                     .visibility = values});
      one.optimizer().apply(commands, std::vector<std::uint64_t>{3});
      StepReport report = one.step({&view});
      report += one.optimizer().finish();
      return report.loss;
    };
    const double without = loss(plain, {255});
    EXPECT_NEAR(loss(lit, {255, 0, 0}), without, 1e-6);
    const double first = loss(lit, {255, 255, 0}), second = loss(lit, {255, 0, 255});
    EXPECT_GT(std::abs(first - without), 1e-3);
    EXPECT_GT(std::abs(second - first), 1e-4) << "each light its own row";
  }

  [[nodiscard]] double psnr(const Trial& trial) const { return scene_.psnr(trial.model().live()); }
  [[nodiscard]] double average_psnr(const Trial& trial) const { return scene_.psnr(trial.model().average()); }

  /// A view in whose left half, which is masked, something else shows.
  static TrainingView half_hidden(const TrainingView& view, std::uint8_t shows) {
    TrainingView hidden = view;
    std::vector<std::uint8_t> color(view.color.data(), view.color.data() + view.color.size());
    std::vector<std::uint8_t> albedo(view.albedo.data(), view.albedo.data() + view.albedo.size());
    std::vector<float> depth(view.depth.data(), view.depth.data() + view.depth.size());
    std::vector<std::uint8_t> mask(depth.size());
    for (std::size_t i = 0; i < mask.size(); ++i) {
      if (i % view.camera.width >= view.camera.width / 2) continue;
      mask[i] = 255;
      depth[i] = 0.5F;
      std::fill_n(color.begin() + static_cast<std::ptrdiff_t>(4 * i), 4, shows);
      std::fill_n(albedo.begin() + static_cast<std::ptrdiff_t>(4 * i), 4, shows);
    }
    hidden.color = Pixels<std::uint8_t>(std::move(color));
    hidden.albedo = Pixels<std::uint8_t>(std::move(albedo));
    hidden.depth = Pixels<float>(std::move(depth));
    hidden.mask = Pixels<std::uint8_t>(std::move(mask));
    return hidden;
  }

  /// Nothing of what is masked reaches the model.
  void masked_pixels_teach_nothing(Device memory, double tolerance) {
    const Settings settings{{"depth_weight", "0.5"}};
    Trial dark = trial(memory, settings), bright = trial(memory, settings), plain = trial(memory, settings);
    for (const auto& view : scene_.views()) {
      dark.put(half_hidden(*view, 0));
      bright.put(half_hidden(*view, 255));
    }
    for (Trial* s : {&dark, &bright, &plain}) s->train(40);
    expect_close(dark, bright, tolerance);
    EXPECT_GT(distance(dark.model().live(), plain.model().live(), ParameterLayout::kResidual), 10 * tolerance);
    EXPECT_GT(psnr(dark), psnr(plain) - 6) << "every place is in some picture's other half";
  }

  /// The scene's views with every surface of another colour.
  [[nodiscard]] std::vector<TrainingView> repainted() const {
    std::vector<TrainingView> views;
    for (const TrainingViewPtr& view : scene_.views()) {
      TrainingView& painted = views.emplace_back(*view);
      for (Pixels<std::uint8_t>* picture : {&painted.color, &painted.albedo}) {
        std::vector<std::uint8_t> rgba(picture->data(), picture->data() + picture->size());
        for (std::size_t i = 0; i < rgba.size(); i += 4) std::swap(rgba[i], rgba[i + 2]);
        *picture = Pixels<std::uint8_t>(std::move(rgba));
      }
    }
    return views;
  }

  /// Mean loss of the last of `steps` steps after everything was repainted, of a model whose rates had fallen.
  double loss_after_repainting(Device memory, const std::string& recovery, int steps) {
    Trial s = trial(memory, {{"lr_half_life_steps", "20"}, {"lr_recovery", recovery}, {"prune", "false"}});
    s.train(800);
    for (const TrainingView& view : repainted()) s.put(view);
    s.train(steps - 12);
    return s.train(12);
  }
  /// The same of a model that begins with these views.
  double loss_of_a_fresh_model(Device memory, int steps) {
    Trial s = trial(memory, {{"lr_half_life_steps", "20"}, {"prune", "false"}});
    for (const TrainingView& view : repainted()) s.put(view);
    s.train(steps - 12);
    return s.train(12);
  }

  // Small: a step takes a second when every access to shared memory is checked.
  SyntheticScene scene_{100, 4, 32};
  int trials_ = 0;
};

}  // namespace splatbus::trainer
