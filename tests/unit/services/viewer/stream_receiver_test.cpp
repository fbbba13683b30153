// What a thread that draws gets from the one that receives.
#include "viewer/stream_receiver.h"

#include <gtest/gtest.h>

#include <cmath>

#include "../../stream/expectations.h"
#include "../../stream/scene_expectations.h"
#include "../streamer/stream_fixture.h"
#include "stream/display_gaussians.h"

namespace splatbus::stream_test {
namespace {

using namespace std::chrono_literals;
using viewer::StreamReceiver;

class StreamReceiverTest : public StreamTest {
 protected:
  /// Takes, as a viewer does, until the condition holds.
  bool take_until(StreamReceiver& receiver, const std::function<bool()>& condition) {
    return bus_test::eventually([&] {
      receiver.wait_for(1ms);
      (void)receiver.take(shown_);
      display_.apply(shown_.changes);
      return condition();
    });
  }

  /// How many are shown once no more come.
  std::size_t take_all(StreamReceiver& receiver) {
    std::size_t count = 0;
    auto since = std::chrono::steady_clock::now();
    EXPECT_TRUE(take_until(receiver, [&] {
      const auto now = std::chrono::steady_clock::now();
      if (std::exchange(count, display_.count()) != count) since = now;
      return count > 0 && now - since > 500ms;
    }));
    return count;
  }

  viewer::Shown shown_;
  stream::DisplayGaussians display_;
};

TEST_F(StreamReceiverTest, WhatIsDrawnFollowsWhatIsPublished) {
  start_streamer({{"visibility_hz", "100"}});
  GaussiansBuffer model = stream::test::toy_model(500, 1);
  trainer_.publish(model);
  StreamReceiver receiver(client_options("one"));
  ASSERT_TRUE(take_until(receiver, [&] { return display_.count() == 500; }));
  std::mt19937 random(2);
  std::normal_distribution<float> normal(0, 0.05F);
  for (int round = 0; round < 5; ++round) {
    for (float& value : model.parameters) value += normal(random);
    trainer_.publish(model);
    SceneState scene{.light = {.generation = 3}, .objects = {}, .version = static_cast<std::uint64_t>(round) + 1};
    scene.objects[7].rigid.translation.y = static_cast<float>(round);
    trainer_.publish_scene(scene);
    // Of each Gaussian the nearest mean that is shown is its own.
    const auto near = [&] {
      std::vector<float> want(model.parameters.begin(), model.parameters.begin() + 500);
      std::vector<float> got;
      for (const IndexRange& range : display_.view().ranges) {
        for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
          if (stream::test::is_shown(display_.view(), i)) got.push_back(*display_.view().at(0, i));
        }
      }
      std::ranges::sort(want);
      std::ranges::sort(got);
      for (std::size_t i = 0; i < want.size(); ++i) {
        if (std::abs(want[i] - got[i]) > 0.01F) return false;
      }
      return shown_.scene->version == scene.version;
    };
    ASSERT_TRUE(take_until(receiver, near)) << round;
    stream::test::expect_scene_near(*shown_.scene, scene);
  }
}

// A picture may take as long as it likes.
TEST_F(StreamReceiverTest, ReceivesWhileNobodyTakes) {
  start_streamer();
  GaussiansBuffer model = stream::test::toy_model(3000, 1);
  trainer_.publish(model);
  StreamReceiver receiver(client_options("one"));
  ASSERT_TRUE(take_until(receiver, [&] { return display_.count() == 3000; }));
  const std::uint64_t received = receiver.status().received_bytes;
  std::mt19937 random(2);
  std::normal_distribution<float> normal(0, 0.5F);
  SceneState scene;
  const bool came = bus_test::eventually([&] {
    for (float& value : model.parameters) value += normal(random);
    trainer_.publish(model);
    ++scene.version;
    trainer_.publish_scene(scene, bus::now_ns());
    return receiver.status().received_bytes > received + 3'000'000 && receiver.status().scene_delays > 10;
  });
  ASSERT_TRUE(came);
  // Three megabytes of changes to a model of one are that model.
  ASSERT_TRUE(receiver.take(shown_));
  EXPECT_LT(shown_.changes.bytes(), std::size_t{4} << 20);
  display_.apply(shown_.changes);
  EXPECT_EQ(display_.count(), 3000U);
  EXPECT_GT(shown_.scene->version, 0U);
  EXPECT_EQ(receiver.status().refused, 0U);
}

TEST_F(StreamReceiverTest, WhatIsShownStaysUntilAModelOfAnotherSizeIsThere) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(6000, 1));
  viewer::ClientOptions options = client_options("one");
  options.max_gaussians = 3000;
  StreamReceiver receiver(options);
  const std::size_t few = take_all(receiver);
  EXPECT_LE(few, 3000U);
  receiver.set_budget(6000, 0);
  std::size_t least = few;
  EXPECT_TRUE(take_until(receiver, [&] {
    least = std::min(least, display_.count());
    return display_.count() == 6000;
  }));
  EXPECT_GE(least, few * 9 / 10) << "much less was shown meanwhile";
  const viewer::ShownModel copy = receiver.copy_model().get();
  stream::DisplayGaussians copied;
  copied.apply(copy.changes);
  EXPECT_EQ(stream::test::count_shown(copied.view()), 6000U);
}

TEST_F(StreamReceiverTest, WhatThereIsNoRoomForIsNotWaitedFor) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(6000, 1));
  StreamReceiver receiver(client_options("one"));
  ASSERT_TRUE(take_until(receiver, [&] { return display_.count() == 6000; }));
  for (const std::size_t budget : {3000, 5000}) {
    const std::size_t before = display_.count();
    receiver.set_budget(budget, 0);
    ASSERT_TRUE(take_until(receiver, [&] { return display_.count() != before; })) << budget;
    const std::size_t now = take_all(receiver);
    EXPECT_LE(now, budget);
    EXPECT_GT(now, budget / 2);
    // What moves goes on.
    SceneState scene{.light = {.generation = 1}, .objects = {}, .version = budget};
    trainer_.publish_scene(scene);
    EXPECT_TRUE(take_until(receiver, [&] { return shown_.scene->version == budget; }));
  }
}

TEST_F(StreamReceiverTest, OverASlowLinkWhatIsThereIsShownSoonerOrLater) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(6000, 1));
  StreamReceiver receiver(client_options("one"));
  ASSERT_TRUE(take_until(receiver, [&] { return display_.count() == 6000; }));
  receiver.set_budget(5900, 100);
  std::size_t first = 6000;
  ASSERT_TRUE(take_until(receiver, [&] { return (first = display_.count()) != 6000; }));
  EXPECT_GT(first, 0U);
  EXPECT_LT(first, 5000U) << "it is as slow as asked for";
}

TEST_F(StreamReceiverTest, WhatIsThereIsShownWhereNothingWas) {
  start_streamer();
  StreamReceiver receiver(client_options("one"));
  receiver.set_budget(7000, 1000);
  trainer_.publish(stream::test::toy_model(6000, 1));
  ASSERT_TRUE(take_until(receiver, [&] { return display_.count() > 0; }));
  EXPECT_LT(display_.count(), 5000U);
}

TEST_F(StreamReceiverTest, AModelThatIsNotThereIsNotCopied) {
  start_streamer();
  StreamReceiver receiver(client_options("one"));
  EXPECT_THROW((void)receiver.copy_model().get(), std::runtime_error);
  trainer_.publish(stream::test::toy_model(6000, 1));
  ASSERT_TRUE(take_until(receiver, [&] { return display_.count() == 6000; }));
  EXPECT_NO_THROW((void)receiver.copy_model().get());
  receiver.set_budget(6500, 100);
  EXPECT_TRUE(bus_test::eventually([&] { return receiver.status().missing_pages > 0; }));
  EXPECT_THROW((void)receiver.copy_model().get(), std::runtime_error) << "half of one";
}

TEST_F(StreamReceiverTest, WhatIsSentLeavesWhileNothingArrives) {
  start_streamer();
  const auto observer = connect("observer");
  bus::Subscriber poses(observer, {"viewer/pose"});
  StreamReceiver receiver(client_options("eye"));
  ASSERT_TRUE(bus_test::eventually([&] { return receiver.status().connected; }));
  EXPECT_TRUE(bus_test::eventually([&] {
    receiver.send_pose(look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1));
    return poses.receive(1ms).has_value();
  }));
}

}  // namespace
}  // namespace splatbus::stream_test
