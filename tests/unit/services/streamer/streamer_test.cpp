// What viewers and the bus get from the streamer.
#include <cmath>
#include <map>

#include "../../stream/scene_expectations.h"
#include "bus/clock.h"
#include "streamer_fixture.h"
#include "wire/capture_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {
namespace {

TEST_F(StreamerTest, AViewerGetsTheModelAndFollowsIt) {
  start_streamer();
  GaussiansBuffer model = stream::test::toy_model(500, 1);
  trainer_.publish(model);
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 500; }, client));
  grow(model, 300, 2);
  trainer_.publish(model);
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 800; }, client));
  EXPECT_EQ(client.refused(), 0U);
  EXPECT_EQ(client.lacked(), 0U);
  // What it shows is what was published, to within the quantizers.
  EXPECT_TRUE(poll_until([&] { return ids_by_row(client.replica(), model).size() == 800; }, client));
}

TEST_F(StreamerTest, AModelThatIsPublishedBeforeStreamerAndViewerStartIsFound) {
  trainer_.publish(stream::test::toy_model(200, 1));
  start_streamer();
  StreamClient client(client_options("one"));
  EXPECT_TRUE(poll_until([&] { return client.replica().count() == 200; }, client));
}

TEST_F(StreamerTest, ViewersThatJoinAtAnyTimeHoldTheSame) {
  start_streamer();
  std::mt19937 random(3);
  GaussiansBuffer model = stream::test::toy_model(400, 1);
  trainer_.publish(model);
  StreamClient first(client_options("first"));
  ASSERT_TRUE(poll_until([&] { return first.replica().count() == 400; }, first));
  disturb(model, random);
  grow(model, 100, 4);
  trainer_.publish(model);
  ASSERT_TRUE(poll_until([&] { return first.replica().count() == 500; }, first));
  StreamClient late(client_options("late"));
  ASSERT_TRUE(poll_until([&] { return late.replica().count() == 500; }, first, late));
  for (int round = 0; round < 5; ++round) {
    disturb(model, random);
    trainer_.publish(model);
    ASSERT_TRUE(poll_until([&] { return ids_by_row(first.replica(), model).size() > 400; }, first, late));
  }
  EXPECT_TRUE(poll_until([&] { return hold_the_same(first.replica(), late.replica()); }, first, late));
}

TEST_F(StreamerTest, PosesProbesAndQualityReachTheBus) {
  start_streamer();
  bus::Subscriber poses(observer_, {"viewer/pose"}), probes(observer_, {"viewer/probe"}),
      qualities(observer_, {"viewer/quality"});
  viewer::ClientOptions options = client_options("eye");
  options.probes = true;
  StreamClient client(options);
  ASSERT_TRUE(poll_until([&] { return client.connected(); }, client));
  const Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 64, 48, 1);
  EXPECT_TRUE(wait_message<wire::ViewerPose>(
      poses, "ViewerPose/1",
      [](const auto& body) { return body.viewer()->str() == "eye" && body.camera()->width() == 64; },
      [&] { client.send_pose(camera), client.poll(1ms); }));
  EXPECT_TRUE(wait_message<wire::ViewerProbe>(
      probes, "ViewerProbe/1", [](const auto& body) { return body.probe_id() == 42; },
      [&] { client.send_probe(42, camera), client.poll(1ms); }));
  // Of a picture that it was sent, and of no other.
  bus::Publisher publisher(observer_);
  const std::vector<std::uint8_t> pixels(std::size_t{64} * 48 * 4);
  const auto answer = [&](std::uint64_t id) {
    const bus::OutgoingTensor color{
        .name = "color", .shape = {48, 64, 4}, .type = bus::ElementType::U8, .inline_data = pixels.data()};
    const wire::Camera wired = to_wire(camera);
    publisher.publish(topics::kCaptureProbe, {.tensors = {color}}, [&](auto& builder, auto header) {
      return wire::CreateCaptureProbe(builder, header, id, &wired, to_wire(builder, SceneState{}, 1));
    });
  };
  ASSERT_TRUE(poll_until([&] { return answer(42), client.take_probe_answer().has_value(); }, client));
  client.send_quality(41, {31, 0.4, 0.1}, 7);
  EXPECT_TRUE(wait_message<wire::ViewerQuality>(
      qualities, "ViewerQuality/1",
      [](const auto& body) {
        EXPECT_EQ(body.probe_id(), 42U);
        return body.ssim() == 0.5F && body.viewer()->str() == "eye";
      },
      [&] {
        client.send_quality(42, {30, 0.5, 0.1}, 7), client.poll(1ms);
      }));
}

TEST_F(StreamerTest, ProbePicturesReachThoseWhoWantThem) {
  start_streamer();
  viewer::ClientOptions wants = client_options("wants");
  wants.probes = true;
  StreamClient with(wants), without(client_options("without"));
  ASSERT_TRUE(poll_until([&] { return with.connected() && without.connected(); }, with, without));
  const Camera camera = look_at({1, 2, 3}, {0, 0, 0}, 16, 8, 1);
  const wire::Camera wired = to_wire(camera);
  std::vector<std::uint8_t> pixels(std::size_t{16} * 8 * 4);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<std::uint8_t>(i);
  bus::Publisher publisher(observer_);
  std::optional<viewer::ProbeAnswer> answer;
  Light light;
  light.generation = 3;
  const auto publish = [&](std::uint32_t width) {
    const bus::OutgoingTensor color{
        .name = "color", .shape = {8, width, 4}, .type = bus::ElementType::U8, .inline_data = pixels.data()};
    publisher.publish(topics::kCaptureProbe, {.tensors = {color}}, [&](auto& builder, auto header) {
      return wire::CreateCaptureProbe(builder, header, 9, &wired,
                                      to_wire(builder, SceneState{.light = light, .objects = {{3, {}}}}, 1, 0.5));
    });
  };
  publish(15);  // a tensor that is not the camera's size is refused
  ASSERT_TRUE(
      poll_until([&] { return publish(16), answer = with.take_probe_answer(), answer.has_value(); }, with, without));
  EXPECT_EQ(answer->probe_id, 9U);
  EXPECT_EQ(answer->rgba, pixels);
  EXPECT_EQ(answer->scene.light.generation, 3U);
  EXPECT_EQ(answer->scene.objects.size(), 1U);
  EXPECT_FALSE(without.take_probe_answer());
}

TEST_F(StreamerTest, LightReachesTheViewer) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(50, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 50; }, client));
  Light light;
  light.generation = 12;
  light.sun_irradiance = {3, 2, 1};
  trainer_.publish_light(light);
  EXPECT_TRUE(poll_until([&] { return client.replica().scene().light.generation == 12; }, client));
  EXPECT_EQ(client.replica().scene().light.sun_irradiance, light.sun_irradiance);
}

TEST_F(StreamerTest, TheSceneIsTheSameAtAViewerAtEachVersion) {
  start_streamer({{"tick_hz", "0.1"}});
  trainer_.publish(stream::test::toy_model(300, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 300; }, client));
  SceneState scene;
  for (std::uint64_t version = 1; version <= 60; ++version) {
    const float t = static_cast<float>(version) / 30;
    scene.version = version * 1'000'000'007;
    scene.light.generation = version;
    scene.light.sun_irradiance = glm::vec3(3, 2, 1);
    scene.light.sun_direction = glm::normalize(glm::vec3(std::cos(t), 1, std::sin(t)));
    scene.objects[7].rigid = {glm::angleAxis(t, glm::vec3(0, 1, 0)), {std::sin(t), 0.5F, 1 / t}};
    if (version == 20) scene.objects[0xFFFFFFFEU].rigid = {glm::angleAxis(t, glm::vec3(1, 0, 0)), {1, 2, 3}};
    if (version == 40) scene.objects.erase(0xFFFFFFFEU);
    trainer_.publish_scene(scene, static_cast<std::int64_t>(version));
    ASSERT_TRUE(poll_until([&] { return client.replica().scene_version() == scene.version; }, client)) << version;
    stream::test::expect_scene_near(client.replica().scene(), scene);
    EXPECT_EQ(client.replica().scene_instant().capture_ns, static_cast<std::int64_t>(version));
  }
  EXPECT_EQ(client.refused(), 0U);
  EXPECT_EQ(client.lacked(), 0U);
  StreamClient late(client_options("late"));
  ASSERT_TRUE(poll_until([&] { return late.replica().scene_version() == scene.version; }, client, late));
  stream::test::expect_scene_near(late.replica().scene(), scene);
}

TEST_F(StreamerTest, ASceneThatIsNoneIsRefusedAndTheNextOneComes) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(50, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 50; }, client));
  SceneState scene;
  scene.version = 5;
  trainer_.publish_scene(scene);
  scene.version = 4;
  scene.objects[1];
  trainer_.publish_scene(scene);
  scene.version = 6;
  scene.objects[1].rigid.translation.x = std::nanf("");
  trainer_.publish_scene(scene);
  scene.objects[1].rigid.translation.x = 1;
  scene.version = 7;
  trainer_.publish_scene(scene);
  std::vector<std::uint64_t> seen;
  EXPECT_TRUE(poll_until(
      [&] {
        const std::uint64_t version = client.replica().scene_version();
        if (version != 0 && (seen.empty() || seen.back() != version)) seen.push_back(version);
        return version == 7;
      },
      client));
  for (const std::uint64_t version : seen) EXPECT_TRUE(version == 5 || version == 7) << version;
  EXPECT_EQ(client.refused(), 0U);
}

TEST_F(StreamerTest, VisibilityReachesTheGaussiansThatItIsOf) {
  start_streamer({{"visibility_hz", "100"}});
  const GaussiansBuffer model = stream::test::toy_model(1500, 1);
  const std::vector<std::uint32_t> index = trainer_.publish(model);
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 1500; }, client));
  const auto of_index = [&](std::uint64_t salt) {
    std::vector<std::uint8_t> visibility(*std::ranges::max_element(index) + 1);
    for (std::size_t i = 0; i < index.size(); ++i) visibility[index[i]] = (model.gaussian_id[i] + salt) % 3 ? 0 : 255;
    return visibility;
  };
  const std::uint64_t generation = trainer_.generation();
  // What is said of a structure that the streamer has not seen yet waits for it.
  trainer_.publish_visibility(of_index(20), generation + 1, 20);
  trainer_.publish_light({.generation = 1});
  ASSERT_TRUE(poll_until([&] { return client.replica().scene_version() != 0; }, client));
  for (std::uint64_t version = 5; version < 10; ++version) {
    trainer_.publish_visibility(of_index(77), generation - 1, version + 1);  // of a structure that was
    trainer_.publish_visibility(of_index(version), generation, version);
    trainer_.publish_visibility(of_index(78), generation, version - 1);  // of a picture's scene, which has passed
    ASSERT_TRUE(poll_until([&] { return client.replica().visibility_version() == version; }, client));
    const stream::ReplicatedState& held = client.replica().held();
    const auto& seen = held.gaussians.channels[held.layout.at(stream::Attribute::Visibility).first];
    const auto ids = ids_by_row(client.replica(), model);
    ASSERT_GT(ids.size(), 1480U);
    for (const auto& [row, id] : ids) ASSERT_EQ(seen[row], (id + version) % 3 ? 0 : 255) << id;
  }
  trainer_.publish(model);
  EXPECT_TRUE(poll_until([&] { return client.replica().visibility_version() == 20; }, client));
  trainer_.publish_visibility({1, 2, 3}, generation + 1, 21);
  trainer_.publish_visibility(of_index(22), generation + 1, 22);
  EXPECT_TRUE(poll_until([&] { return client.replica().visibility_version() == 22; }, client));
  EXPECT_EQ(client.refused(), 0U);
}

/// relight has said its last word of a model that viewers have a part of: the rest is not lit through walls when it
/// comes.
TEST_F(StreamerTest, GaussiansThatComeLaterSeeWhatWasSaidOfThemBefore) {
  constexpr std::size_t kAll = 6000;
  start_streamer({{"visibility_hz", "100"}, {"budget_kbps", "2000"}, {"viewer_kbps", "2000"}});
  trainer_.publish_scene(
      {.light = {.generation = 1, .sources = {{.id = 4, .intensity = glm::vec3(1)}}}, .objects = {}, .version = 1});
  trainer_.publish(stream::test::toy_model(200, 1));
  StreamClient client(client_options("one"));
  ASSERT_TRUE(
      poll_until([&] { return client.replica().count() == 200 && client.replica().scene_version() == 1; }, client));
  const GaussiansBuffer model = stream::test::toy_model(kAll, 1);
  const std::vector<std::uint32_t> index = trainer_.publish(model);
  const std::size_t indices = *std::ranges::max_element(index) + 1;
  std::vector<std::uint8_t> rows(2 * indices, 255);
  for (std::size_t i = 0; i < index.size(); ++i) rows[indices + index[i]] = model.gaussian_id[i] % 2 ? 0 : 255;
  trainer_.publish_visibility(rows, trainer_.generation(), 1, {0, 4});
  ASSERT_TRUE(poll_until([&] { return client.replica().visibility_version() == 1; }, client));
  const auto wrong = [&] {
    const stream::ReplicatedState& held = client.replica().held();
    const std::vector<std::uint8_t>* const row = held.light_rows.find(4);
    if (row == nullptr) return kAll;
    std::size_t count = 0;
    for (const auto& [at, id] : ids_by_row(client.replica(), model)) count += (*row)[at] != (id % 2 ? 0 : 255);
    return count;
  };
  EXPECT_TRUE(poll_until([&] { return client.replica().count() == kAll && wrong() == 0; }, client)) << wrong();
}

TEST_F(StreamerTest, StatisticsAddUp) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(500, 1));
  StreamClient client(client_options("one"));
  bus::Subscriber stats(observer_, {"stream/stats"});
  ASSERT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/2", [](const auto& body) { return body.gaussians() == 500 && body.total_bytes() > 0; },
      [&] { client.poll(1ms); }));
  EXPECT_TRUE(wait_message<wire::StreamStats>(
      stats, "StreamStats/2",
      [&](const auto& body) {
        std::uint64_t sum = 0;
        for (const auto* type : *body.by_type()) sum += type->total_bytes();
        EXPECT_EQ(sum, body.total_bytes());
        EXPECT_EQ(body.viewers(), 1U);
        EXPECT_EQ(body.model_gaussians(), 500U);
        EXPECT_GT(body.wire_mbps_mean(), 0);
        return true;
      },
      [&] { client.poll(1ms); }));
}

}  // namespace
}  // namespace splatbus::stream_test
