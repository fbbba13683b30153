// How frames reach readers: rings that hold them, and a bus that comes later, goes, or has another engine of that name.
#include <gmock/gmock.h>

#include <algorithm>
#include <filesystem>
#include <utility>

#include "../bus/child_process.h"
#include "sdk/frame_rings.h"
#include "sdk/frame_sender.h"
#include "sdk_fixture.h"

namespace splatbus::engine_test {
namespace {

using testing::HasSubstr;

/// Submits frames 0 to count - 1, whose pixels have the frame's number.
void submit_numbered(splatbus_engine* engine, std::uint8_t count) {
  for (std::uint8_t i = 0; i < count; ++i) {
    OwnedFrame owned(small_camera());
    owned.frame.frame = i;
    owned.objects = {{i + 1U, {{1, 0, 0, 0}, {1, 2, 3}}, 1, 0}};
    owned.refresh();
    std::ranges::fill(owned.color, i);
    ASSERT_EQ(splatbus_engine_submit(engine, &owned.frame), SPLATBUS_OK) << splatbus_engine_last_error(engine);
  }
}

/// Until it is shown, the broker takes messages and no slabs.
class HiddenSlabs {
 public:
  explicit HiddenSlabs(std::filesystem::path socket)
      : socket_(std::move(socket)), hidden_(socket_.string() + ".hidden") {
    std::filesystem::rename(socket_, hidden_);
  }
  void show() { std::filesystem::rename(hidden_, socket_); }

 private:
  std::filesystem::path socket_, hidden_;
};

TEST_F(SdkTest, ReadersHaveRoomForManyFrames) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open();
  submit_numbered(engine.get(), 1);  // from here on they have a ring
  ASSERT_TRUE(frames.receive(patience).has_value());
  constexpr std::size_t kFrames = 100;
  for (std::size_t i = 0; i < kFrames; ++i) {
    OwnedFrame owned(small_camera());
    owned.frame.frame = i;
    std::ranges::fill(owned.color, static_cast<std::uint8_t>(i));
    ASSERT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK);
  }
  for (std::size_t i = 0; i < kFrames; ++i) {
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    const auto color = message->tensor("color");
    ASSERT_TRUE(color.has_value()) << "frame " << i << " was overwritten";
    EXPECT_EQ(color->as<std::uint8_t>()[0], i);
  }
}

/// More than half a ring of one size, which are waited for together, and others between them.
TEST_F(SdkTest, FramesThatAreSubmittedTogetherArriveInTheirOrder) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open();
  const auto camera = [](std::size_t i) {
    splatbus_camera made = small_camera(static_cast<std::uint32_t>(i));
    if (i % 7 == 3) made.width = 8000;
    return made;
  };
  for (const std::size_t i : {0U, 3U}) {  // from here on both sizes have rings
    OwnedFrame first(camera(i));
    ASSERT_EQ(splatbus_engine_submit(engine.get(), &first.frame), SPLATBUS_OK);
    ASSERT_TRUE(frames.receive(patience).has_value());
  }
  std::vector<OwnedFrame> owned;
  for (std::size_t i = 0; i < 100; ++i) {
    owned.emplace_back(camera(i));
    owned.back().frame.frame = 6 + i / 4;
    std::ranges::fill(owned.back().color, static_cast<std::uint8_t>(i));
  }
  std::vector<splatbus_frame> together;
  for (OwnedFrame& frame : owned) {
    frame.refresh();
    together.push_back(frame.frame);
  }
  ASSERT_EQ(splatbus_engine_submit_all(engine.get(), together.data(), together.size()), SPLATBUS_OK)
      << splatbus_engine_last_error(engine.get());
  std::int64_t captured_ns = 0;
  for (std::size_t i = 0; i < together.size(); ++i) {
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    const auto& frame = message->root<wire::EngineFrame>();
    ASSERT_EQ(frame.camera()->id(), i);
    EXPECT_EQ(frame.scene()->frame(), 6 + i / 4);
    const std::int64_t capture_ns = message->header().capture_ns();
    EXPECT_TRUE(i % 4 == 0 ? capture_ns > captured_ns : capture_ns == captured_ns) << "one moment is one frame's";
    captured_ns = capture_ns;
    const auto color = message->tensor("color", bus::ElementType::U8, {6, owned[i].frame.camera.width, 4});
    ASSERT_TRUE(color.has_value()) << "frame " << i << " was overwritten";
    EXPECT_EQ(color->as<std::uint8_t>()[0], i);
    EXPECT_EQ(color->as<std::uint8_t>()[owned[i].color.size() - 1], i);
  }
  EXPECT_EQ(splatbus_engine_submit_all(engine.get(), nullptr, 0), SPLATBUS_OK);
}

class FrameRingsTest : public BusTest {
 protected:
  static constexpr std::int64_t kSecond = 1'000'000'000;

  FrameRingsTest() : context_(connect("engine")), frames_(connect("tester"), {"engine/frame"}) {
    EXPECT_TRUE(frames_.wait_connected(patience));
  }
  /// One of that width is submitted, and arrives.
  void submit(std::uint32_t width, std::int64_t now_ns) {
    splatbus_camera camera = small_camera();
    camera.width = width;
    OwnedFrame owned(camera);
    auto written = rings_.write({&owned.frame, 1}, now_ns);
    sender_.send(owned.frame, std::move(written.front()), 1);
    const auto message = frames_.receive(patience);
    ASSERT_TRUE(message.has_value());
    EXPECT_TRUE(message->tensor("color").has_value());
  }
  std::size_t give_back(std::int64_t now_ns) {
    auto unused = rings_.take_unused(now_ns);
    for (auto& ring : unused) sender_.give_back(std::move(ring));
    return unused.size();
  }

  std::shared_ptr<bus::Context> context_;
  bus::Subscriber frames_;
  engine_sdk::FrameRings rings_{context_, Device::Cpu};
  engine_sdk::FrameSender sender_{context_};
};

TEST_F(FrameRingsTest, OneThatNobodyWritesToForLongIsGivenBack) {
  submit(8, 0);
  submit(8000, 0);
  ASSERT_EQ(broker_->statistics().slabs, 2U);
  submit(8, 29 * kSecond);
  EXPECT_EQ(give_back(30 * kSecond - 1), 0U);
  EXPECT_EQ(give_back(30 * kSecond), 1U) << "the large one";
  EXPECT_TRUE(bus_test::eventually([&] { return broker_->statistics().slabs == 1; }));
  submit(8, 31 * kSecond);
  EXPECT_EQ(broker_->statistics().slabs, 1U) << "the other is the one that it was";
  submit(8000, 32 * kSecond);
  EXPECT_EQ(broker_->statistics().slabs, 2U) << "and what is needed again is there again";
}

TEST_F(FrameRingsTest, OneWhoseFramesAreStillToBeSentStays) {
  OwnedFrame owned(small_camera());
  auto written = rings_.write({&owned.frame, 1}, 0);
  EXPECT_TRUE(rings_.take_unused(100 * kSecond).empty());
  written.clear();
  EXPECT_EQ(rings_.take_unused(100 * kSecond).size(), 1U);
}

TEST_F(SdkTest, TheEngineOutlivesTheBroker) {
  const Engine engine = open();
  OwnedFrame owned(small_camera());
  ASSERT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK);
  broker_.reset();
  ++owned.frame.frame;
  EXPECT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK);
  broker_ = std::make_unique<bus_service::Broker>(options());
  broker_->start();

  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {{.camera = small_camera(21)}});
  EXPECT_EQ(wait_for_change(engine.get()).size(), 1U);
  const bool again = bus_test::eventually([&] {
    ++owned.frame.frame;
    if (splatbus_engine_submit(engine.get(), &owned.frame) != SPLATBUS_OK) return false;
    const auto message = frames.receive(std::chrono::milliseconds(100));
    return message && message->tensor("color").has_value();
  });
  EXPECT_TRUE(again);
}

constexpr std::uint8_t kNumbered = 150;
constexpr std::uint8_t kHalfARing = 64;

TEST_F(SdkTest, SubmitNeedsNoBroker) {
  broker_.reset();
  const Engine engine = open();
  submit_numbered(engine.get(), kNumbered);
  EXPECT_EQ(splatbus_engine_frames_dropped(engine.get()), kNumbered - kHalfARing);
}

TEST_F(SdkTest, TheNewestFramesArriveOnceTheirMemoryCanBeFound) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  ASSERT_TRUE(context->wait_connected(patience));
  HiddenSlabs slabs(directory_.address().slab_socket());
  const Engine engine = open();
  submit_numbered(engine.get(), kNumbered);
  slabs.show();
  for (std::uint64_t expected = kNumbered - kHalfARing; expected < kNumbered; ++expected) {
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    const wire::SceneState& scene = *message->root<wire::EngineFrame>().scene();
    ASSERT_EQ(scene.frame(), expected);
    EXPECT_EQ(scene.objects()->Get(0)->id(), expected + 1);
    const auto color = message->tensor("color");
    ASSERT_TRUE(color.has_value()) << "of frame " << expected;
    EXPECT_EQ(color->as<std::uint8_t>()[0], expected);
  }
  EXPECT_EQ(splatbus_engine_frames_dropped(engine.get()), kNumbered - kHalfARing);
}

/// Objects and light, where no camera is due.
splatbus_frame scene_alone(std::uint64_t number, std::vector<splatbus_object>& objects) {
  objects = {{static_cast<std::uint32_t>(number) + 1U, {{1, 0, 0, 0}, {1, 2, 3}}, 1, 0}};
  splatbus_frame frame{};
  frame.frame = number;
  frame.time_s = 0.5;
  frame.camera.fx = kNan;
  frame.light.sun_direction[1] = 1;
  frame.objects = objects.data();
  frame.object_count = objects.size();
  return frame;
}

TEST_F(SdkTest, AFrameWithoutImagesSaysObjectsAndLight) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open();
  std::vector<splatbus_object> objects;
  const splatbus_frame first = scene_alone(0, objects);
  ASSERT_EQ(splatbus_engine_submit(engine.get(), &first), SPLATBUS_OK) << splatbus_engine_last_error(engine.get());
  auto message = frames.receive(patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->root<wire::EngineFrame>().scene()->objects()->Get(0)->id(), 1U);
  EXPECT_FALSE(message->announces("color"));
  // What is wrong with it is refused all the same.
  splatbus_frame wrong = scene_alone(1, objects);
  wrong.light.sun_direction[1] = kNan;
  EXPECT_EQ(splatbus_engine_submit(engine.get(), &wrong), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_THAT(splatbus_engine_last_error(engine.get()), HasSubstr("sun_direction"));
}

TEST_F(SdkTest, FramesWithoutImagesStayBehindThoseBeforeThem) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  ASSERT_TRUE(context->wait_connected(patience));
  HiddenSlabs slabs(directory_.address().slab_socket());
  const Engine engine = open();
  submit_numbered(engine.get(), 2);
  std::vector<splatbus_object> objects;
  for (std::uint64_t number = 2; number < 1000; ++number) {
    const splatbus_frame frame = scene_alone(number, objects);
    ASSERT_EQ(splatbus_engine_submit(engine.get(), &frame), SPLATBUS_OK);
  }
  slabs.show();
  for (const std::uint64_t expected : {0, 1, 999}) {
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    EXPECT_EQ(message->root<wire::EngineFrame>().scene()->frame(), expected);
  }
  EXPECT_EQ(splatbus_engine_frames_dropped(engine.get()), 0U) << "the newest says what the others did";
}

TEST_F(SdkTest, ASecondEngineOfOneNameIsToldSo) {
  const bus_test::ChildProcess first("bus-test-service", {"--bus", directory_.address().text()},
                                     directory_.path() + "/output");
  ASSERT_TRUE(bus_test::eventually([&] { return broker_->statistics().slabs == 2; }));
  const Engine engine = open("test");
  OwnedFrame owned(small_camera());
  EXPECT_TRUE(
      bus_test::eventually([&] { return splatbus_engine_submit(engine.get(), &owned.frame) == SPLATBUS_ERROR_BUS; }));
  EXPECT_THAT(splatbus_engine_last_error(engine.get()), HasSubstr("was refused"));
  EXPECT_GT(splatbus_engine_frames_dropped(engine.get()), 0U);
}

}  // namespace
}  // namespace splatbus::engine_test
