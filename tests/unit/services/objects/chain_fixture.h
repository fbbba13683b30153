#pragma once

#include <gtest/gtest.h>

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <utility>

#include "../../bus/bus_fixture.h"
#include "../capture_bridge/fake_engine.h"
#include "capture-bridge/capture_bridge.h"
#include "capture-bridge/parameters.h"
#include "expander/expander.h"
#include "expander/parameters.h"
#include "trainer/insert_reader.h"
#include "trainer/optimizer.h"
#include "trainer/reference_reader.h"
#include "trainer/view_sampler.h"
#include "wire/capture_generated.h"
#include "wire/model_generated.h"

namespace splatbus::objects_test {

using namespace std::chrono_literals;
using capture_bridge::test::AnalyticScene;

/// The trainer's parts in the calling thread, so that a test knows what they have seen.
class TrainerHere {
 public:
  TrainerHere(const std::shared_ptr<bus::Context>& context, const trainer::Options& options)
      : options_(options),
        subscriber_(context),
        publisher_(context),
        references_(Device::Cpu, options.max_picture_pixels, std::size_t{1} << 30, host_bytes_),
        inserts_(Device::Cpu, host_bytes_),
        store_(context, options.layout, model::PageStoreOptions{.max_gaussians = options.max_gaussians}),
        optimizer_(store_, options) {
    subscriber_
        .on(topics::kCaptureReference,
            [this](const wire::CaptureReference&, const bus::Message& message) { take_reference(message); })
        .on(topics::kModelInsert, [this](const wire::ModelInsert&, const bus::Message& message) {
          auto reading = inserts_.read(message);
          if (!reading.lost) {
            EXPECT_TRUE(commands_.add(std::move(reading.batch)));
          }
        });
    optimizer_.publish(publisher_);
  }

  /// Takes what has come, and makes a step.
  void step() {
    subscriber_.dispatch_all(0ms, 256);
    const trainer::Commands commands = std::exchange(commands_, {});
    const bool changed = optimizer_.apply(commands);
    optimizer_.step(sampler_.next_batch(views_, 1, {.input = options_.input_view_interval}));
    if (changed || !commands.inserts.empty()) optimizer_.publish(publisher_);
  }

  /// Pictures of reference cameras that it has taken.
  [[nodiscard]] std::uint64_t references() const { return taken_references_; }
  [[nodiscard]] const model::PageStore& store() const { return store_; }

 private:
  void take_reference(const bus::Message& message) {
    const auto reading = references_.read(message, true);
    if (reading.retire) return views_.retire(reading.key);
    if (!reading.view) return;
    taken_references_ += reading.key.role == CameraRole::Reference ? 1 : 0;
    views_.put(reading.view);
    commands_.look(reading.view);
  }

  trainer::Options options_;
  std::atomic<std::uint64_t> host_bytes_{0};
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  trainer::ReferenceReader references_;
  trainer::InsertReader inserts_;
  trainer::ViewStore views_;
  trainer::ViewSampler sampler_{1};
  model::PageStore store_;
  trainer::Optimizer optimizer_;
  trainer::Commands commands_;
  std::uint64_t taken_references_ = 0;
};

/// A capture-bridge, an expander and a trainer's parts on the pictures of an engine that the test turns on, frame by
/// frame: what becomes of objects on the whole way.
class ChainTest : public bus_test::BusTest {
 protected:
  static constexpr std::uint64_t kReferences = 6;
  static constexpr std::uint64_t kFramesABeat = 15;  ///< references at 2 Hz of an engine of 30 frames/s

  ChainTest() : engine_(connect("engine")) {
    set(bridge_parameters_, "input_cameras", "10");
    set(bridge_parameters_, "input_size", "64");
    set(bridge_parameters_, "reference_cameras", std::to_string(kReferences));
    set(bridge_parameters_, "reference_size", "128");
    set(bridge_parameters_, "reference_rate_hz", "0");  // the test keeps the beat
    set(bridge_parameters_, "light_depth_size", "16");
    set(bridge_parameters_, "input_refresh_hz", "1000");
    set(trainer_parameters_, "threads", "1");
    set(trainer_parameters_, "pair_visibility", "false");  // there is no relight
    set(expander_parameters_, "refresh_s", "0");
  }

  static void set(bus::Parameters& parameters, const std::string& name, const std::string& value) {
    EXPECT_EQ(parameters.set(name, value, false), "");
  }

  /// Until all that was seen first is in the model.
  void start() {
    trainer_ = std::make_unique<TrainerHere>(connect("trainer"), trainer_parameters_.read<trainer::Options>());
    expander_ = std::make_unique<expander::Expander>(connect("expander"), expander_parameters_);
    bridge_ = std::make_unique<capture_bridge::CaptureBridge>(connect("capture-bridge"), bridge_parameters_);
    ASSERT_TRUE(
        until([&] { return expander_->counters().rounds > 0 && settled() && trainer_->store().count() > 500; }));
  }

  [[nodiscard]] bool settled() const { return expander_->queue().pending() == 0; }

  /// Runs everything until the condition holds.
  bool until(const std::function<bool()>& condition) {
    return bus_test::eventually(
        [&] {
          bridge_->step(1ms);
          engine_.serve();
          expander_->step(1ms);
          trainer_->step();
          return condition();
        },
        20s);
  }

  /// All reference cameras, at one engine frame, until the trainer has their pictures.
  void beat() {
    const std::uint64_t frame = engine_.frame + kFramesABeat, taken = trainer_->references();
    const auto requests = engine_.requests();
    for (const auto& request : requests) {
      if (request.camera.role != CameraRole::Reference) continue;
      engine_.frame = frame - 1;  // submit() counts on
      engine_.submit(request.camera, request.buffers, request.id);
    }
    EXPECT_TRUE(until([&] { return trainer_->references() >= taken + kReferences; }));
  }

  /// Gaussians of a frame of reference about a point of it, over the floor.
  [[nodiscard]] std::size_t gaussians_about(const glm::vec3& centre, float radius_m, std::uint32_t frame_id) const {
    std::size_t count = 0;
    const GaussiansView view = trainer_->store().view();
    for (const IndexRange& range : view.ranges) {
      if (range.frame_id != frame_id) continue;
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
        constexpr int kMean = ParameterLayout::kMean;
        const glm::vec3 mean(*view.at(kMean, i), *view.at(kMean + 1, i), *view.at(kMean + 2, i));
        count += mean.y > 0.1F && glm::distance(mean, centre) < radius_m ? 1 : 0;
      }
    }
    return count;
  }

  bus::Parameters bridge_parameters_{bus::Parameters::declare<capture_bridge::Options>()};
  bus::Parameters expander_parameters_{bus::Parameters::declare<expander::Options>()};
  bus::Parameters trainer_parameters_{bus::Parameters::declare<trainer::Options>()};
  capture_bridge::test::FakeEngine engine_;
  std::unique_ptr<TrainerHere> trainer_;
  std::unique_ptr<expander::Expander> expander_;
  std::unique_ptr<capture_bridge::CaptureBridge> bridge_;
};

}  // namespace splatbus::objects_test
