#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <vector>

#include "../../bus/bus_fixture.h"
#include "../../nanoseconds.h"
#include "analytic_scene.h"
#include "capture-bridge/round_helper.h"
#include "capture-bridge/round_sharing.h"
#include "liveness.h"
#include "wire/convert.h"
#include "wire/sampling_topics.h"

namespace splatbus::capture_bridge::test {

using namespace std::chrono_literals;

/// A bridge that leads as far as giving rounds away goes, and another one that helps, on a bus.
class RoundSharingTest : public bus_test::BusTest {
 protected:
  static constexpr int kViews = 4, kSize = 32;

  RoundSharingTest()
      : lead_(connect("capture-bridge-1")),
        other_(connect("capture-bridge-2")),
        sharing_(lead_, Device::Cpu, kExpected),
        subscriber_(lead_),
        helper_(other_, Device::Cpu, kExpected),
        rounds_(connect("peer"), {"sampling/round"}) {
    subscriber_
        .on(topics::kSamplingOffer,
            [this](const wire::SamplingOffer& offer, const bus::Message&) { sharing_.offered(*offer.header()); })
        .on(topics::kSamplingResult, [this](const wire::SamplingResult& result, const bus::Message& message) {
          ++answers_;
          if (auto sampled = sharing_.answered(result, message, now_ns_)) sampled_.push_back(std::move(*sampled));
        });
    EXPECT_TRUE(subscriber_.wait_connected(bus_test::patience));
    EXPECT_TRUE(rounds_.wait_connected(bus_test::patience));
  }

  void hear(const std::vector<Node>& nodes) {
    with_liveness(nodes, 0, [&](const wire::Liveness& liveness) { sharing_.take(liveness); });
  }
  [[nodiscard]] Node bridge(const bus::Context& context) const {
    return {.name = context.source(), .epoch = context.epoch(), .kind = "capture-bridge"};
  }
  void hear_both() { hear({bridge(*lead_), bridge(*other_)}); }

  bool until(const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      if (helps_) helper_.step(1ms);
      subscriber_.dispatch_all(1ms);
      return condition();
    });
  }
  void meet_helper() {
    hear_both();
    ASSERT_TRUE(until([&] { return sharing_.has_idle(now_ns_); }));
  }
  /// Until the helper has answered whatever it was given.
  void let_it_answer() {
    const std::size_t before = answers_;
    ASSERT_TRUE(until([&] { return answers_ > before; }));
  }

  static InputJob job(int views = kViews) {
    const AnalyticScene scene;
    InputJob job{.views = {}, .rig_generation = 7, .options = {.budget = 500}};
    for (const Camera& camera : small_dome(views, kSize)) {
      // As an engine says it: every message makes rotations unit once more.
      InputView view = scene.render(from_wire(to_wire(from_wire(to_wire(camera)))));
      view.frame = job.views.size();
      view.light.background = {0.1F, 0.2F, 0.3F};
      view.objects[kFarFieldFrame] = far_field();  // of what is not as the background
      view.objects[AnalyticScene::kBall] = Rigid{.translation = {0.01F * static_cast<float>(view.frame / 2), 0, 0}};
      job.views.push_back(std::make_shared<const InputView>(std::move(view)));
    }
    return job;
  }
  /// The job's id, as the helper reads it.
  std::uint64_t handed_id() {
    const auto message = rounds_.receive(bus_test::patience);
    return message ? message->root<wire::SamplingRound>().job() : 0;
  }
  void answer(std::uint64_t id, const std::shared_ptr<bus::Context>& from,
              const std::vector<bus::OutgoingTensor>& tensors = {}) {
    bus::Publisher(from).publish(topics::kSamplingResult, {.tensors = tensors}, [&](auto& builder, auto header) {
      return wire::CreateSamplingResult(builder, header, id);
    });
  }

  static constexpr RoundSizes kExpected{.views = kViews, .pixels = kSize * kSize, .samples = 500};
  std::shared_ptr<bus::Context> lead_, other_;
  RoundSharing sharing_;
  bus::Subscriber subscriber_;
  RoundHelper helper_;
  bus::Subscriber rounds_;
  bool helps_ = true;
  std::int64_t now_ns_ = kSecond;
  std::size_t answers_ = 0;
  std::vector<RoundSharing::Sampled> sampled_;
};

}  // namespace splatbus::capture_bridge::test
