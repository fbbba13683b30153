#include <gmock/gmock.h>

#include <algorithm>
#include <array>
#include <thread>

#include "../bus/log_capture.h"
#include "bus/clock.h"
#include "c_engine.h"
#include "sdk_fixture.h"

namespace splatbus::engine_test {
namespace {

using testing::HasSubstr;

TEST_F(SdkTest, AnEngineInPlainCTakesPart) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  bus::Subscriber frames(context, {"engine/frame"});
  bus_test::meet(cameras, frames);
  publish_requests(cameras, {{.camera = small_camera(3), .id = 99}});
  int failed = -1;
  std::jthread engine([&] { failed = run_c_engine(directory_.address().text().c_str(), 10000); });
  const auto message = frames.receive(patience);
  ASSERT_TRUE(message.has_value());
  engine.join();
  EXPECT_EQ(failed, 0);

  const auto& frame = message->root<wire::EngineFrame>();
  EXPECT_EQ(message->header().source()->str(), "c-engine");
  EXPECT_GT(message->header().capture_ns(), 0);
  EXPECT_EQ(frame.scene()->frame(), 42U);
  EXPECT_EQ(frame.request_id(), 99U);
  EXPECT_EQ(frame.camera()->id(), 3U);
  ASSERT_EQ(frame.scene()->objects()->size(), 1U);
  EXPECT_EQ(frame.scene()->objects()->Get(0)->id(), 7U);
  EXPECT_FLOAT_EQ(frame.scene()->objects()->Get(0)->world_from_object().translation().z(), 3);
  const auto color = message->tensor("color", bus::ElementType::U8, {6, 8, 4});
  ASSERT_TRUE(color.has_value());
  EXPECT_EQ(color->as<std::uint8_t>()[17], 200);
  const auto depth = message->tensor("depth", bus::ElementType::F32, {6, 8});
  ASSERT_TRUE(depth.has_value());
  EXPECT_FLOAT_EQ(depth->as<float>()[47], 1.5F);
  EXPECT_FALSE(message->tensor("albedo").has_value());
}

TEST_F(SdkTest, RequestsByNameGoBeforeThoseToAllUntilTheirBridgeIsAnother) {
  const bus::Publisher bridge(connect("bridge")), next(connect("next"));
  const Engine engine = open("engine-2");
  const auto wait_for = [&](std::uint64_t id) {
    const auto requests = wait_for_change(engine.get());
    ASSERT_EQ(requests.size(), 1U);
    EXPECT_EQ(requests[0].request_id, id);
  };
  publish_requests(bridge, {{.camera = small_camera(1), .id = 1}});
  wait_for(1);
  publish_requests(bridge, {{.camera = small_camera(1), .id = 2}}, "engine-2");
  wait_for(2);
  publish_requests(bridge, {{.camera = small_camera(1), .id = 3}});
  publish_requests(bridge, {{.camera = small_camera(1), .id = 5}}, "engine-2");
  publish_requests(bridge, {{.camera = small_camera(1), .id = 4}}, "engine-1");
  wait_for(5);
  // What was passed over does not come after all.
  publish_requests(next, {{.camera = small_camera(1), .id = 6}});
  wait_for(6);
}

TEST_F(SdkTest, RequestsArriveAndAreReplaced) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  const Engine engine = open();
  publish_requests(cameras, {{.camera = small_camera(1), .rate_hz = 2}, {.camera = small_camera(2), .id = 8}});
  auto requests = wait_for_change(engine.get());
  ASSERT_EQ(requests.size(), 2U);
  EXPECT_FLOAT_EQ(requests[0].rate_hz, 2);
  EXPECT_EQ(requests[1].request_id, 8U);
  EXPECT_EQ(requests[1].camera.width, 8U);

  publish_requests(cameras, {{.camera = small_camera(2), .id = 9}});
  requests = wait_for_change(engine.get());
  ASSERT_EQ(requests.size(), 1U);
  EXPECT_EQ(requests[0].request_id, 9U);
}

TEST_F(SdkTest, RequestsThatMakeNoSenseAreLeftOut) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  const Engine engine = open();
  std::vector<Request> requests(6, Request{.camera = small_camera(1)});
  requests[0].camera.world_from_camera.translation[0] = kNan;
  requests[1].camera.width = 0;
  requests[2].camera.fx = -1;
  requests[3].rate_hz = kNan;
  requests[4].buffers = static_cast<wire::EngineBuffer>(0);
  requests[5].camera.id = 44;
  publish_requests(cameras, requests);
  const auto taken = wait_for_change(engine.get());
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_EQ(taken[0].camera.id, 44U);
}

/// Any peer may send them, as fast as it likes.
TEST_F(SdkTest, OfRequestsThatMakeNoSenseOneLineASecondIsSaid) {
  std::vector<Request> requests(100, Request{.camera = small_camera(1)});
  for (Request& request : requests) request.camera.width = 8193;
  requests.back().camera = small_camera(44);
  const bus_test::LogCapture log;
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  const Engine engine = open();
  const std::int64_t begin = bus::now_ns();
  for (std::uint64_t set = 1; set <= 20; ++set) {
    requests.back().id = set;
    publish_requests(cameras, requests);
    ASSERT_EQ(wait_for_change(engine.get()).size(), 1U);
  }
  const auto seconds = (bus::now_ns() - begin) / 1'000'000'000;
  EXPECT_LE(log.lines(), 1 + seconds);
  EXPECT_THAT(log.text(), testing::HasSubstr("engine/cameras from tester: 99 of its requests left out: camera 1"));
  EXPECT_THAT(log.text(), testing::HasSubstr("8193 x 6 pixels"));
}

TEST_F(SdkTest, APictureHasTheSizesThatEverybodyTakes) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  const Engine engine = open();
  std::vector<Request> requests(3, Request{.camera = small_camera(1)});
  requests[0].camera.width = 7680;
  requests[0].camera.height = 4320;
  requests[1].camera.width = requests[1].camera.height = 8192;
  requests[1].camera.role = SPLATBUS_ROLE_LIGHT;
  requests[2].camera.height = 8193;
  publish_requests(cameras, requests);
  const auto taken = wait_for_change(engine.get());
  ASSERT_EQ(taken.size(), 2U);
  EXPECT_EQ(taken[0].camera.height, 4320U);
  EXPECT_EQ(taken[1].camera.role, std::uint32_t{SPLATBUS_ROLE_LIGHT});
}

TEST_F(SdkTest, LightRequestsNeedOnlyASize) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  const Engine engine = open();
  Request request{.camera = {}, .buffers = wire::EngineBuffer::LightDepth};
  request.camera.role = SPLATBUS_ROLE_LIGHT;
  request.camera.width = request.camera.height = 64;
  publish_requests(cameras, {request});
  EXPECT_EQ(wait_for_change(engine.get()).size(), 1U);
}

TEST_F(SdkTest, LightRequestsNameTheirMap) {
  const auto context = connect("tester");
  const bus::Publisher cameras(context);
  const Engine engine = open();
  splatbus_camera camera = small_camera(1, SPLATBUS_ROLE_LIGHT);
  camera.world_from_camera.translation[0] = 4.5F;
  std::vector<Request> requests(
      4, Request{.camera = camera, .buffers = wire::EngineBuffer::LightDepth, .light_id = 70000, .light_map = 3});
  requests[0].extent_m = kNan;
  requests[1].extent_m = -1;
  requests[2].extent_m = 1;
  requests[2].camera.world_from_camera.translation[2] = kNan;
  requests[3].extent_m = 12.5F;
  publish_requests(cameras, requests);
  const auto taken = wait_for_change(engine.get());
  ASSERT_EQ(taken.size(), 1U);
  EXPECT_EQ(taken[0].light_id, 70000U);
  EXPECT_EQ(taken[0].light_map, 3U);
  EXPECT_EQ(taken[0].extent_m, 12.5F);
  EXPECT_EQ(taken[0].camera.world_from_camera.translation[0], 4.5F);
}

TEST_F(SdkTest, NullPointersAreArgumentErrors) {
  const auto refused = [](const char* address, const char* source, std::uint32_t abi, std::uint32_t memory,
                          splatbus_engine** out) {
    EXPECT_EQ(splatbus_engine_open(address, source, abi, memory, out), SPLATBUS_ERROR_ARGUMENT);
    return std::string(splatbus_engine_last_error(nullptr));
  };
  constexpr std::uint32_t kHost = SPLATBUS_MEMORY_HOST;
  EXPECT_THAT(refused(nullptr, "x", SPLATBUS_ENGINE_ABI, kHost, nullptr), HasSubstr("out is NULL"));
  splatbus_engine* none = nullptr;
  EXPECT_THAT(refused("ipc:///tmp", nullptr, SPLATBUS_ENGINE_ABI, kHost, &none), HasSubstr("source"));
  EXPECT_THAT(refused("nonsense", "x", SPLATBUS_ENGINE_ABI, kHost, &none), HasSubstr("nonsense"));
  EXPECT_THAT(refused("ipc:///tmp", "x", SPLATBUS_ENGINE_ABI, 7, &none), HasSubstr("7 is not a kind of memory"));
  EXPECT_THAT(refused("ipc:///tmp", "x", SPLATBUS_ENGINE_ABI - 1, kHost, nullptr), HasSubstr("built for ABI"));
  EXPECT_EQ(none, nullptr);
  splatbus_engine_close(nullptr);
  const Engine engine = open();
  EXPECT_EQ(splatbus_engine_submit(engine.get(), nullptr), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_EQ(splatbus_engine_poll(engine.get(), 0, nullptr, nullptr, nullptr), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_EQ(splatbus_engine_counter(engine.get(), nullptr, 1), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_EQ(splatbus_engine_submit(nullptr, nullptr), SPLATBUS_ERROR_ARGUMENT);
  EXPECT_EQ(splatbus_engine_submit_all(engine.get(), nullptr, 2), SPLATBUS_ERROR_ARGUMENT);
}

TEST_F(SdkTest, HeartbeatsCarryCounters) {
  const auto context = connect("tester");
  bus::Subscriber heartbeats(context, {"sys/heartbeat"});
  const Engine engine = open("engine-7");
  ASSERT_EQ(splatbus_engine_counter(engine.get(), "render_ms", 12.5), SPLATBUS_OK);
  const auto beat = [&] {
    const auto message = heartbeats.receive(std::chrono::milliseconds(500));
    if (!message || message->header().source()->str() != "engine-7") return false;
    const auto& root = message->root<wire::Heartbeat>();
    return root.service()->str() == "engine" && root.counters() != nullptr && root.counters()->size() == 1 &&
           root.counters()->Get(0)->value() == 12.5;
  };
  EXPECT_TRUE(bus_test::eventually(beat));
}

TEST_F(SdkTest, TheLightsGenerationFollowsTheLight) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open();
  std::vector<std::uint64_t> generations;
  OwnedFrame owned(small_camera());
  for (const float irradiance : {1.0F, 1.0F, 2.0F}) {
    owned.frame.light.sun_irradiance[0] = irradiance;
    ++owned.frame.frame;
    ASSERT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK)
        << splatbus_engine_last_error(engine.get());
    const auto message = frames.receive(patience);
    ASSERT_TRUE(message.has_value());
    generations.push_back(message->root<wire::EngineFrame>().scene()->light()->generation());
  }
  EXPECT_EQ(generations[0], generations[1]);
  EXPECT_NE(generations[1], generations[2]);
}

TEST_F(SdkTest, LightsObjectsAndMapsArriveAsTheyWere) {
  const auto context = connect("tester");
  bus::Subscriber frames(context, {"engine/frame"});
  ASSERT_TRUE(frames.wait_connected(patience));
  const Engine engine = open();
  const splatbus_light_source spot{.id = 0xFFFFFFFF,
                                   .kind = SPLATBUS_LIGHT_SPOT,
                                   .casts_shadow = 1,
                                   .position = {1.1F, -2.2F, 3.3F},
                                   .direction = {0.6F, 0, -0.8F},
                                   .intensity = {0.1F, 20, 3e5F},
                                   .range_m = 12.25F,
                                   .cos_inner = 0.95F,
                                   .cos_outer = 0.55F,
                                   .depth_version = 0x1234567890ABCDEF};
  splatbus_light_source directional = spot, point = spot;
  directional.id = 9;
  directional.kind = SPLATBUS_LIGHT_DIRECTIONAL;
  directional.casts_shadow = 0;
  point.id = 3;
  point.kind = SPLATBUS_LIGHT_POINT;
  point.depth_version = 5;
  std::vector<splatbus_light_source> sources{spot, point, directional};
  OwnedFrame owned(small_camera(6, SPLATBUS_ROLE_LIGHT));
  owned.objects = {{8, {{1, 0, 0, 0}, {1, 2, 3}}, 0.75F, SPLATBUS_OBJECT_EMISSIVE},
                   {4, {{0, 1, 0, 0}, {4, 5, 6}}, 1.25F, SPLATBUS_OBJECT_EMISSIVE | SPLATBUS_OBJECT_NOT_MODELLED}};
  owned.refresh();
  owned.frame.light_id = 3;
  owned.frame.light_map = 5;
  owned.frame.light.sources = sources.data();
  owned.frame.light.source_count = sources.size();
  owned.frame.light.sun_depth_version = 0xFEDCBA0987654321;
  const auto submitted = [&] {
    EXPECT_EQ(splatbus_engine_submit(engine.get(), &owned.frame), SPLATBUS_OK)
        << splatbus_engine_last_error(engine.get());
    auto message = frames.receive(patience);
    EXPECT_TRUE(message.has_value());
    return std::move(message).value();
  };
  const bus::Message message = submitted();
  const auto& frame = message.root<wire::EngineFrame>();
  EXPECT_EQ(frame.light_id(), 3U);
  EXPECT_EQ(frame.light_map(), 5U);
  const wire::Light& light = *frame.scene()->light();
  EXPECT_EQ(light.sun_depth_version(), 0xFEDCBA0987654321U);
  // What does not count for its kind arrives as 0.
  std::fill_n(directional.position, 3, 0.0F);
  directional.range_m = 0;
  std::fill_n(point.direction, 3, 0.0F);
  for (splatbus_light_source* const uncut : {&point, &directional}) uncut->cos_inner = uncut->cos_outer = 0;
  const std::array<splatbus_light_source, 3> by_id{point, directional, spot};
  ASSERT_EQ(light.sources()->size(), by_id.size());
  for (std::uint32_t i = 0; i < by_id.size(); ++i) {
    const wire::LightSource& found = *light.sources()->Get(i);
    const splatbus_light_source& sent = by_id.at(i);
    const auto same = [](const wire::Vec3& a, const float(&b)[3]) {
      return a.x() == b[0] && a.y() == b[1] && a.z() == b[2];
    };
    EXPECT_EQ(found.id(), sent.id);
    EXPECT_EQ(static_cast<std::uint32_t>(found.kind()), sent.kind);
    EXPECT_EQ(found.casts_shadow(), sent.casts_shadow != 0);
    EXPECT_TRUE(same(found.position(), sent.position)) << i;
    EXPECT_TRUE(same(found.direction(), sent.direction)) << i;
    EXPECT_TRUE(same(found.intensity(), sent.intensity)) << i;
    EXPECT_EQ(found.range_m(), sent.range_m);
    EXPECT_EQ(found.cos_inner(), sent.cos_inner);
    EXPECT_EQ(found.cos_outer(), sent.cos_outer);
    EXPECT_EQ(found.depth_version(), sent.depth_version);
  }
  const auto& objects = *frame.scene()->objects();
  ASSERT_EQ(objects.size(), 2U);
  EXPECT_EQ(objects.Get(0)->scale(), 0.75F);
  EXPECT_EQ(objects.Get(0)->flags(), wire::ObjectFlags::Emissive);
  EXPECT_EQ(objects.Get(1)->scale(), 1.25F);
  EXPECT_EQ(objects.Get(1)->flags(), wire::ObjectFlags::Emissive | wire::ObjectFlags::NotModelled);

  // The light's generation follows what its sources shine, not their maps.
  const auto generation = [&] { return submitted().root<wire::EngineFrame>().scene()->light()->generation(); };
  sources[1].depth_version = 6;
  EXPECT_EQ(generation(), light.generation());
  sources[1].intensity[1] = 21;
  EXPECT_NE(generation(), light.generation());
}

}  // namespace
}  // namespace splatbus::engine_test
