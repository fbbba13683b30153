#include "sim/engine_loop.h"

#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <thread>

#include "render_scenes.h"
#include "sdk_fixture.h"
#include "source_scenes.h"

namespace splatbus::engine_test {
namespace {

using wire::EngineBuffer;

/// The engine with a small scene, on a thread of its own.
class EngineLoopTest : public SdkTest {
 protected:
  using Motion = std::function<std::optional<sim::Pose>(double)>;

  /// `motion` is that of the scene's object 2, within 2 m along x.
  void start(double sun_rate_deg_s, const Motion& motion = {}, double fps = 50,
             const std::vector<sim::LightSource>& sources = {}, double pictures_s = 1000,
             const std::string& shares_clock_as = "") {
    threads_.emplace_back([this, sun_rate_deg_s, motion, fps, sources, pictures_s, shares_clock_as] {
      sim::Scene scene;
      sim::add_plain(scene, sim::box({4, 0.1F, 4}), glm::vec3(0.5F));
      sim::add_plain(scene, sim::box({0.4F, 0.4F, 0.4F}), glm::vec3(0.3F, 0.5F, 0.2F));
      scene.objects.back().motion_origins.add(glm::vec3(0));
      scene.objects.back().motion_origins.add(glm::vec3(2, 0, 0));
      scene.objects.back().motion = motion;
      scene.lighting.sun_rate_deg_s = sun_rate_deg_s;
      scene.lighting.sources = sources;
      sim::Renderer renderer(std::make_shared<GlContext>(), std::move(scene), {.shadow_map_size = 256});
      const bool shares_clock = !shares_clock_as.empty();
      const sim::EngineHandle engine =
          sim::open_engine(directory_.address().text(), shares_clock ? shares_clock_as : "engine");
      sim::EngineLoop(*engine, renderer, nullptr, {.fps = fps, .pictures_s = pictures_s, .shared_clock = shares_clock})
          .run(stop_);
    });
  }
  ~EngineLoopTest() override { stop_ = true; }

  /// Past frames that say what moved and nothing else.
  static std::optional<bus::Message> next_camera(bus::Subscriber& frames, std::chrono::milliseconds timeout) {
    while (auto message = frames.receive(timeout)) {
      const auto* tensors = message->header().tensors();
      if (tensors != nullptr && tensors->size() > 0) return message;
    }
    return {};
  }

  static Request request(std::uint32_t id, EngineBuffer buffers, float rate_hz, std::uint64_t request_id = 1) {
    Request result{.camera = sim::look_at({0, 1, 3}, {0, 0, 0}, 24, 16, 50),
                   .buffers = buffers,
                   .rate_hz = rate_hz,
                   .id = request_id};
    result.camera.id = id;
    return result;
  }
  static Request probe_request() {
    Request result = request(9, EngineBuffer::Color, 50);
    result.camera.role = SPLATBUS_ROLE_PROBE;
    return result;
  }
  static Request light_request(std::uint32_t id = 0, std::uint32_t light_id = 0, std::uint8_t light_map = 0) {
    Request result{.camera = {}, .buffers = EngineBuffer::LightDepth, .light_id = light_id, .light_map = light_map};
    result.camera.id = id;
    result.camera.role = SPLATBUS_ROLE_LIGHT;
    result.camera.width = result.camera.height = 32;
    return result;
  }

  std::atomic<bool> stop_ = false;
  std::vector<std::jthread> threads_;
};

TEST_F(EngineLoopTest, AnswersRequestsAndTheirUpdates) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {request(1, EngineBuffer::Color | EngineBuffer::ObjectId, 0, 11), light_request()});
  start(0);

  std::map<std::uint64_t, bus::Message> answers;
  while (answers.size() < 2) {
    auto message = next_camera(frames, patience);
    ASSERT_TRUE(message.has_value());
    const std::uint64_t id = message->root<wire::EngineFrame>().request_id();
    answers.emplace(id, std::move(*message));
  }
  const bus::Message& picture = answers.at(11);
  EXPECT_TRUE(picture.tensor("color", bus::ElementType::U8, {16, 24, 4}).has_value());
  const auto object_id = picture.tensor("object_id", bus::ElementType::U32, {16, 24});
  ASSERT_TRUE(object_id.has_value());
  EXPECT_EQ(object_id->as<std::uint32_t>()[7 * 24 + 12], 2U);
  EXPECT_FALSE(picture.tensor("normal").has_value());
  const auto& light = answers.at(1).root<wire::EngineFrame>();
  EXPECT_EQ(light.camera()->role(), wire::CameraRole::Light);
  EXPECT_GT(light.camera()->fx(), 0);
  EXPECT_TRUE(answers.at(1).tensor("light_depth", bus::ElementType::F32, {32, 32}).has_value());

  // A static scene: only the new request is answered.
  publish_requests(cameras,
                   {request(1, EngineBuffer::Color, 0, 11), request(2, EngineBuffer::Albedo, 0, 12), light_request()});
  const auto message = next_camera(frames, patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->root<wire::EngineFrame>().request_id(), 12U);
  EXPECT_TRUE(message->tensor("albedo").has_value());
  EXPECT_FALSE(next_camera(frames, std::chrono::milliseconds(100)).has_value());
}

TEST_F(EngineLoopTest, AFrameWithoutTimeHasItsDepthMapAndOnePictureAndCamerasTakeTurns) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {request(1, EngineBuffer::Color, 50), request(2, EngineBuffer::Color, 50),
                             request(3, EngineBuffer::Color, 50), light_request(), probe_request()});
  start(20, {}, 50, {}, 0);
  std::map<std::uint64_t, std::vector<std::uint32_t>> pictures_of_frame;
  std::map<std::uint64_t, int> maps_of_frame;
  std::map<std::uint32_t, int> pictures_of_camera;
  while (pictures_of_frame.size() < 22) {
    const auto message = next_camera(frames, patience);
    ASSERT_TRUE(message.has_value());
    const auto& frame = message->root<wire::EngineFrame>();
    if (frame.camera()->role() == wire::CameraRole::Light) {
      ++maps_of_frame[frame.scene()->frame()];
    } else if (frame.camera()->role() != wire::CameraRole::Probe) {  // which takes nobody's place
      pictures_of_frame[frame.scene()->frame()].push_back(frame.camera()->id());
      if (pictures_of_frame.size() <= 21) ++pictures_of_camera[frame.camera()->id()];
    }
  }
  // All of them are newcomers in the first frame when they reach an engine that stands in it.
  pictures_of_frame.erase(pictures_of_frame.begin());
  for (const auto& [frame, pictures] : pictures_of_frame) {
    EXPECT_EQ(pictures.size(), 1U) << frame;
    EXPECT_EQ(maps_of_frame[frame], 1) << frame;
  }
  for (const std::uint32_t id : {1U, 2U, 3U}) EXPECT_NEAR(pictures_of_camera[id], 7, 1) << id;
}

TEST_F(EngineLoopTest, FramesCarryTheirInstant) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {request(1, EngineBuffer::Depth, 25), light_request()});
  start(90, [](double time_s) { return sim::Pose{.translation = {static_cast<float>(0.1 * time_s), 0.5F, 0}}; });
  int pictures = 0;
  int lights = 0;
  std::optional<std::uint64_t> last_generation;
  while (pictures < 4 || lights < 4) {
    const auto message = next_camera(frames, patience);
    ASSERT_TRUE(message.has_value());
    const auto& frame = message->root<wire::EngineFrame>();
    EXPECT_NEAR(frame.scene()->time_s(), static_cast<double>(frame.scene()->frame()) / 50, 1e-9);
    ASSERT_EQ(frame.scene()->objects()->size(), 1U);
    EXPECT_EQ(frame.scene()->objects()->Get(0)->id(), 2U);
    EXPECT_NEAR(frame.scene()->objects()->Get(0)->world_from_object().translation().x(), 0.1 * frame.scene()->time_s(),
                1e-5);
    if (frame.camera()->role() == wire::CameraRole::Light) {
      ++lights;
      EXPECT_NE(last_generation, frame.scene()->light()->generation());
      last_generation = frame.scene()->light()->generation();
    } else {
      ++pictures;
    }
  }
}

TEST_F(EngineLoopTest, WhatMovesIsSaidThoughNoCameraIsDue) {
  bus::Subscriber frames(connect("tester"), {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  // It rests from then on.
  const auto x_m = [](double time_s) { return static_cast<float>(std::min(time_s, 0.4)); };
  start(0, [x_m](double time_s) { return sim::Pose{.translation = {x_m(time_s), 0.5F, 0}}; });
  std::uint64_t last = 0;
  for (double time_s = 0; time_s < 0.4;) {
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    const auto& scene = *message->root<wire::EngineFrame>().scene();
    EXPECT_TRUE(last == 0 || scene.frame() > last) << "once a frame";
    last = scene.frame();
    time_s = scene.time_s();
    EXPECT_NEAR(scene.objects()->Get(0)->world_from_object().translation().x(), x_m(time_s), 1e-5F);
  }
  EXPECT_FALSE(frames.receive(std::chrono::milliseconds(100)).has_value());
}

TEST_F(EngineLoopTest, LightDepthFollowsWhatComesAndGoes) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {light_request()});
  // There in every other tenth of a second, at one place.
  const auto exists = [](double time_s) { return std::fmod(time_s + 1e-6, 0.2) < 0.1; };
  start(0, [exists](double time_s) { return exists(time_s) ? std::optional(sim::Pose{}) : std::nullopt; });
  std::optional<bool> before;
  for (int i = 0; i < 6; ++i) {
    const auto message = next_camera(frames, patience);
    ASSERT_TRUE(message.has_value());
    const auto& scene = *message->root<wire::EngineFrame>().scene();
    const bool listed = scene.objects() != nullptr && scene.objects()->size() == 1;
    EXPECT_EQ(listed, exists(scene.time_s())) << scene.time_s();
    EXPECT_NE(before, listed) << "rendered again for no change";
    before = listed;
  }
}

/// One that moves, from second 0, and one that is there in every other fifth of a second, at one place.
TEST_F(EngineLoopTest, AllDepthMapsOfAPictureComeBeforeIt) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  // The picture has the least id, and is a probe: neither puts it before the maps.
  Request picture = request(0, EngineBuffer::Color, 25, 50);
  picture.camera.role = SPLATBUS_ROLE_PROBE;
  std::vector<Request> requests{picture, light_request(1, 0), light_request(9, 2)};
  for (std::uint8_t face = 0; face < 6; ++face) requests.push_back(light_request(2 + face, 1, face));
  publish_requests(cameras, requests);
  const auto exists = [](double time_s) { return std::fmod(time_s + 1e-6, 0.4) >= 0.2; };
  const sim::LightSource moves{.id = 1, .at = [](double time_s) {
                                 splatbus_light_source source = sim::point_source();
                                 source.position[0] = static_cast<float>(0.1 * time_s);
                                 return std::optional(source);
                               }};
  const sim::LightSource visits{.id = 2, .at = [exists](double time_s) {
                                  return exists(time_s) ? std::optional(sim::spot_source()) : std::nullopt;
                                }};
  start(0, {}, 50, {moves, visits});
  std::set<std::array<std::uint64_t, 3>> maps;  // light, map, depth version
  std::map<std::uint32_t, std::set<std::uint64_t>> versions;
  for (int pictures = 0; pictures < 30;) {
    const auto message = next_camera(frames, patience);
    ASSERT_TRUE(message.has_value());
    const auto& frame = message->root<wire::EngineFrame>();
    const wire::Light& light = *frame.scene()->light();
    const auto version_of = [&](std::uint32_t id) {
      for (const wire::LightSource* source : *light.sources()) {
        if (source->id() == id) return source->depth_version();
      }
      return std::uint64_t{0};
    };
    if (frame.camera()->role() == wire::CameraRole::Light) {
      const std::uint32_t id = frame.light_id();
      EXPECT_TRUE(message->tensor("light_depth", bus::ElementType::F32, {32, 32}).has_value());
      const std::uint64_t version = id == 0 ? light.sun_depth_version() : version_of(id);
      EXPECT_TRUE(maps.insert({id, frame.light_map(), version}).second) << "again for no change";
      versions[id].insert(version);
      continue;
    }
    ++pictures;
    EXPECT_TRUE(maps.contains({0, 0, light.sun_depth_version()}));
    for (std::uint64_t face = 0; face < 6; ++face) EXPECT_TRUE(maps.contains({1, face, version_of(1)})) << face;
    const std::uint64_t visitor = version_of(2);
    EXPECT_EQ(visitor != 0, exists(frame.scene()->time_s()));
    if (visitor != 0) {
      EXPECT_TRUE(maps.contains({2, 0, visitor}));
    }
  }
  EXPECT_EQ(versions[0].size(), 1U);
  EXPECT_GT(versions[1].size(), 20U);
  EXPECT_GE(versions[2].size(), 2U);
}

TEST_F(EngineLoopTest, NewCamerasDoNotWaitForTheNextFrame) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {request(1, EngineBuffer::Color, 0, 1)});
  start(0, {}, 0.1);  // ten seconds a frame
  const auto first = next_camera(frames, patience);
  ASSERT_TRUE(first.has_value());
  std::vector<Request> requests;
  for (std::uint32_t id = 2; id < 12; ++id) requests.push_back(request(id, EngineBuffer::Color, 0, id));
  publish_requests(cameras, requests);
  for (std::size_t i = 0; i < requests.size(); ++i) {
    const auto message = next_camera(frames, std::chrono::seconds(5));
    ASSERT_TRUE(message.has_value()) << i;
    EXPECT_EQ(message->root<wire::EngineFrame>().scene()->frame(), first->root<wire::EngineFrame>().scene()->frame());
  }
}

TEST_F(EngineLoopTest, EnginesThatShareAClockShowTheSameThoughOneStartsLaterAndSkipsFrames) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  constexpr double kFps = 100;
  const auto motion = [](double time_s) {
    return sim::Pose{.translation = {static_cast<float>(1 + std::sin(time_s)), 0.5F, 0}};
  };
  start(15, motion, kFps, {}, 1000, "a");
  ASSERT_TRUE(frames.receive(patience).has_value());
  // More than it renders in a frame: it skips some, again and again.
  Request large = request(1, EngineBuffer::Color, 100);
  large.camera.width = 2400;
  large.camera.height = 1600;
  publish_requests(cameras, {large}, "b");
  start(15, motion, kFps, {}, 1000, "b");
  std::map<std::uint64_t, std::map<std::string, std::vector<std::uint8_t>>> objects;  // by frame and engine
  std::map<std::uint64_t, std::map<std::string, std::uint64_t>> lights;
  std::set<std::uint64_t> of_b;
  std::size_t common = 0;
  while (common < 8) {
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    const auto& scene = *message->root<wire::EngineFrame>().scene();
    const std::string source = message->header().source()->str();
    const auto* const first = reinterpret_cast<const std::uint8_t*>(scene.objects()->Get(0));
    // However late a frame is: a clock of the engine's own would be off by all the time before it started.
    EXPECT_NEAR(scene.time_s(), static_cast<double>(message->header().capture_ns()) * 1e-9, 20);
    objects[scene.frame()][source] = {first, first + sizeof(wire::ObjectTransform)};
    lights[scene.frame()][source] = scene.light()->generation();
    if (source == "b") of_b.insert(scene.frame());
    common = static_cast<std::size_t>(
        std::ranges::count_if(objects, [](const auto& frame) { return frame.second.size() == 2; }));
  }
  for (const auto& [frame, shown] : objects) {
    EXPECT_TRUE(shown.size() < 2 || shown.at("a") == shown.at("b")) << frame;
  }
  for (const auto& [frame, light] : lights) {
    EXPECT_TRUE(light.size() < 2 || light.at("a") == light.at("b")) << frame;
  }
  // After a gap it goes on where one that skips as many, or half as many, goes on.
  std::uint64_t widest = 0;
  for (auto frame = std::next(of_b.begin()); frame != of_b.end(); ++frame) {
    const std::uint64_t gap = *frame - *std::prev(frame);
    widest = std::max(widest, gap);
    EXPECT_EQ(*frame % std::bit_floor(gap), 0U) << gap;
  }
  EXPECT_GT(widest, 1U);
}

TEST_F(EngineLoopTest, ACameraThatCannotBeRenderedDisturbsNoOther) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  Request huge = request(1, EngineBuffer::Color, 0, 5);
  huge.camera.width = huge.camera.height = 8000;
  publish_requests(cameras, {huge, request(2, EngineBuffer::Color, 0, 6)});
  start(0);
  const auto message = next_camera(frames, patience);
  ASSERT_TRUE(message.has_value());
  EXPECT_EQ(message->root<wire::EngineFrame>().request_id(), 6U);
}

}  // namespace
}  // namespace splatbus::engine_test
