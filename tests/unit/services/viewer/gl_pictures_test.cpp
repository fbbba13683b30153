#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "../../stream/toy_server.h"
#include "gl/context.h"
#include "metrics/image_io.h"
#include "metrics/metrics.h"
#include "raster/model_renderer.h"
#include "stream/display_gaussians.h"
#include "viewer/gl/file_rows.h"
#include "viewer/gl/stage.h"
#include "viewer/row_feed.h"

namespace splatbus::viewer {
namespace {

using stream::test::ToyServer;

constexpr std::uint32_t kSide = 256;
constexpr int kCameras = 6;

Camera camera_of(int index) {
  const float turn = 1.1F * static_cast<float>(index), far = 2.5F + 0.6F * static_cast<float>(index);
  const glm::vec3 eye(far * std::cos(turn), 0.4F + 0.5F * static_cast<float>(index), far * std::sin(turn));
  return look_at(eye, {0, 0.2F, 0}, kSide, kSide, 0.9F);
}

cv::Mat picture_of(const gl::Picture& picture) {
  return metrics::from_rgba(picture.rgba.data(), static_cast<std::uint32_t>(picture.width),
                            static_cast<std::uint32_t>(picture.height));
}

/// Two replicas of the same packets: one that OpenGL draws, one way or the other, and one for the CPU's rasteriser.
class GlPictures : public ::testing::TestWithParam<gl::Draw> {
 protected:
  GlPictures() : feed_(drawn_, false), stage_(GetParam()), renderer_(raster::make_model_renderer(Device::Cpu)) {}

  void send(const std::vector<stream::EncodedPacket>& packets) {
    for (stream::Replica* replica : {&drawn_, &truth_}) stream::test::send(packets, *replica);
  }
  void send_pages(ToyServer& server) {
    for (stream::Replica* replica : {&drawn_, &truth_}) stream::test::send_pages(server.stream, *replica);
  }
  void join(ToyServer& server) {
    for (stream::Replica* replica : {&drawn_, &truth_}) stream::test::join(server.stream, *replica);
  }
  void feed() {
    if (gl::SharedBatch batch = feed_.take(1)) stage_.add(*batch);
  }
  /// By the way under test: the first pictures may make room for its lists.
  gl::Picture capture(const Camera& camera, const SceneState& scene, float time_s) {
    for (int k = 0; k < 3; ++k) {
      const gl::Drawn before = stage_.drawn();
      gl::Picture picture = stage_.capture(camera, scene, time_s);
      const gl::Drawn& now = stage_.drawn();
      const bool by_tiles = now.by_tiles > before.by_tiles;
      EXPECT_NE(by_tiles, now.by_quads > before.by_quads);
      if (by_tiles == (GetParam() == gl::Draw::Tiles)) return picture;
    }
    ADD_FAILURE() << "drawn the other way";
    return {};
  }
  cv::Mat drawn(const Camera& camera) { return picture_of(capture(camera, drawn_.scene(), 10)); }
  cv::Mat truth(const Camera& camera) {
    display_.apply(truth_.take_changes());
    const SceneState scene = truth_.scene();
    const GaussiansView view = display_.view(scene.light.sources);
    renderer_->read_in_place(view);
    raster::Render render;
    renderer_->draw(camera, scene, {}, render);
    return metrics::from_planes(render.color.data.data(), camera.width, camera.height,
                                view.layout.appearance == Appearance::Transfer);
  }
  void expect_alike(const std::string& what) {
    feed();
    for (int k = 0; k < kCameras; ++k) {
      const cv::Mat expected = truth(camera_of(k));
      const metrics::Quality quality = metrics::compare(drawn(camera_of(k)), expected);
      EXPECT_GE(quality.psnr_db, 45) << what << ", camera " << k;
      EXPECT_GE(quality.ssim, 0.998) << what << ", camera " << k;
      EXPECT_LE(quality.flip, 0.01) << what << ", camera " << k;
      cv::Scalar mean, spread;
      cv::meanStdDev(expected, mean, spread);
      EXPECT_GT(spread[0], 5) << "the picture shows something";
    }
  }

  GlContext context_;
  stream::Replica drawn_, truth_;
  RowFeed feed_;
  gl::Stage stage_;
  stream::DisplayGaussians display_;
  std::unique_ptr<raster::ModelRenderer> renderer_;
};

Light light_at(float turn) {
  Light light{.sun_direction = glm::normalize(glm::vec3(std::cos(turn), 1, std::sin(turn))),
              .sun_irradiance = {3, 2.5F, 2},
              .background = {0.2F, 0.4F, 0.8F},
              .sources = {}};
  light.ambient_sh[0] = {0.5F, 0.6F, 0.7F};
  light.sources.push_back({.id = 4, .position = {1, 1, 0}, .intensity = {2, 1, 0}});
  return light;
}

TEST_P(GlPictures, AreTheCpuRasterisersOfALivingModel) {
  ToyServer server(21, 20'000);
  server.scene.objects[1] = ObjectTransform(Rigid{.translation = {0, 0.3F, 0}});
  server.scene.objects[7] = ObjectTransform(Rigid{.translation = {0, 0.5F, -0.2F}});
  server.scene.objects[2] = ObjectTransform(Rigid{.rotation = glm::angleAxis(0.5F, glm::vec3(0, 1, 0))});
  server.scene.light = light_at(0);
  server.change_scene();
  for (int k = 0; k < 20; ++k) server.train(0.001F);  // some become an object's
  join(server);
  send(server.tick());
  send_pages(server);
  expect_alike("whole");

  server.remove(1000);
  server.insert(1500);
  server.train(0.02F);
  server.scene.objects[1].rigid.translation.x = 0.4F;
  server.scene.objects[7].rigid.translation.x = -0.5F;
  server.scene.objects[2].scale = 1.5F;
  send(server.tick());
  send_pages(server);
  expect_alike("after removals, appends and motion");

  server.scene.light = light_at(2);
  server.scene.objects.erase(7);
  send(server.change_scene());
  send(server.tick());
  send_pages(server);
  expect_alike("under another light, without an object");
}

TEST_P(GlPictures, OfALivingRadianceModelToo) {
  for (const int degree : {1, 2, 3}) {
    SCOPED_TRACE(degree);
    ToyServer server(3, 4000, Appearance::Radiance, {}, 76 + static_cast<std::uint64_t>(degree), degree);
    server.scene.objects[1] = ObjectTransform(Rigid{.rotation = glm::angleAxis(1.0F, glm::vec3(0, 1, 0))});
    server.scene.light.background = {0.1F, 0.3F, 0.2F};
    server.change_scene();
    join(server);
    send(server.tick());
    send_pages(server);
    expect_alike("whole");
    server.remove(300);
    server.insert(500);
    server.train(0.02F);
    send(server.tick());
    send_pages(server);
    expect_alike("after removals, appends and training");
  }
}

TEST_P(GlPictures, UploadWhatChangesAndNothingElse) {
  ToyServer server(5, 3000);
  join(server);
  feed();
  EXPECT_EQ(stage_.uploaded().rows, 3000U);
  EXPECT_EQ(stage_.uploaded().bytes, 3000U * (sizeof(stream::GpuRecord) + 8));
  static_cast<void>(drawn(camera_of(1)));
  EXPECT_EQ(feed_.take(2), nullptr);
  EXPECT_EQ(stage_.uploaded().rows, 3000U) << "another camera is no change";
  server.remove(30);
  const auto packets = server.tick();
  const std::size_t left = server.stream.held().count;
  send(packets);
  feed();
  const std::size_t rows = stage_.uploaded().rows - 3000;
  EXPECT_GE(rows, 3000 - left);
  EXPECT_LE(rows, 150U) << "those that go, and those that take their lanes, in some pages";
}

TEST_P(GlPictures, FadeInAndOut) {
  RowFeed fading(truth_, true);
  ToyServer server(5, 500);
  server.scene.light = light_at(0);
  server.change_scene();
  join(server);
  const Camera camera = camera_of(0);
  const auto share = [&](float time_s) {  // of the whole picture's difference from the background
    const gl::Picture picture = capture(camera, truth_.scene(), time_s);
    double sum = 0;
    for (std::size_t k = 0; k < picture.rgba.size(); k += 4) {
      for (std::size_t c = 0; c < 3; ++c) sum += std::abs(picture.rgba[k + c] - picture.rgba[c]);
    }
    return sum;
  };
  const auto take = [&](float time_s) {
    if (gl::SharedBatch batch = fading.take(time_s)) stage_.add(*batch);
  };
  take(10);
  const double all = share(11);
  EXPECT_EQ(share(10), 0);
  EXPECT_GT(share(10.15F), 0.2 * all);
  EXPECT_LT(share(10.15F), 0.9 * all);
  std::vector<std::uint32_t> pages;
  for (const auto& [page, held] : truth_.held().pages) pages.push_back(page);
  truth_.receive(stream::test::parse(server.stream.gone_packet(pages)));
  take(20);
  EXPECT_NEAR(share(20), all, 1e-3 * all) << "still there";
  EXPECT_LT(share(20.15F), 0.9 * all);
  EXPECT_EQ(share(20.3F), 0);
  take(20.3F);
  static_cast<void>(stage_.capture(camera, truth_.scene(), gl::kSettled_s));
  EXPECT_EQ(stage_.count_seen(), 0U) << "the rows are free";
}

TEST_P(GlPictures, OfAFileAreTheCpuRasterisersToo) {
  GaussiansBuffer file = stream::test::toy_model(1500, 4, 1, Appearance::Radiance, 3);
  file.object_id.assign(file.object_id.size(), 0);
  SceneState scene;
  scene.light.background = {0.2F, 0.1F, 0.3F};
  renderer_->take(file.view());
  stage_.add(*gl::rows_of(file.view()));
  for (const bool antialias : {true, false}) {
    stage_.set_antialias(antialias);
    for (int k = 0; k < kCameras; ++k) {
      raster::Render render;
      renderer_->draw(camera_of(k), scene, {.antialias = antialias}, render);
      const cv::Mat expected = metrics::from_planes(render.color.data.data(), kSide, kSide, false);
      const metrics::Quality quality =
          metrics::compare(picture_of(capture(camera_of(k), scene, gl::kSettled_s)), expected);
      EXPECT_GE(quality.psnr_db, 45) << "camera " << k;
      EXPECT_GE(quality.ssim, 0.998) << "camera " << k;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Ways, GlPictures, ::testing::Values(gl::Draw::Quads, gl::Draw::Tiles),
                         [](const auto& test) { return test.param == gl::Draw::Tiles ? "Tiles" : "Quads"; });

}  // namespace
}  // namespace splatbus::viewer
