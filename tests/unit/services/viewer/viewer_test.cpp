#include "viewer/viewer.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <utility>

#include "../streamer/stream_fixture.h"
#include "bus/clock.h"
#include "bus/error.h"
#include "metrics/image_io.h"
#include "raster/model_renderer.h"
#include "wire/capture_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;

class ViewerTest : public StreamTest {
 protected:
  ViewerTest() : peer_(connect("peer")), out_(directory_.path() + "/out") {}
  ~ViewerTest() override { stop_viewer(); }

  void start_viewer(const std::vector<std::pair<std::string, std::string>>& changes,
                    const std::optional<viewer::Place>& place = {}) {
    stop_ = std::stop_source();
    parameters_ = std::make_unique<bus::Parameters>(bus::Parameters::declare<viewer::Options>());
    for (const auto& [name, value] : changes) ASSERT_EQ(parameters_->set(name, value, false), "");
    viewer_ =
        std::make_unique<viewer::Viewer>(*parameters_, viewer::ViewerHost{.name = "viewer",
                                                                          .endpoint = endpoint(),
                                                                          .stop = stop_.get_token(),
                                                                          .counter =
                                                                              [this](const auto& name, double value) {
                                                                                if (name == "unwritten_pictures")
                                                                                  unwritten_ = value;
                                                                              },
                                                                          .detail = [](const auto&) {},
                                                                          .place = place});
    thread_ = std::thread([this] { viewer_->run(); });
  }
  void stop_viewer() {
    stop_.request_stop();
    if (thread_.joinable()) thread_.join();
  }

  /// Where it said last that it is, on its orbit: radians, from +x towards +z.
  double told_angle(bus::Subscriber& poses) {
    std::optional<double> angle;
    EXPECT_TRUE(bus_test::eventually([&] {
      while (const auto message = poses.receive(1ms)) {
        const Camera camera = from_wire(*message->root<wire::ViewerPose>().camera());
        const glm::vec3 eye = camera.world_from_camera.translation;
        angle = std::atan2(eye.z, eye.x);
      }
      return angle.has_value();
    }));
    return angle.value_or(0);
  }

  std::shared_ptr<bus::Context> peer_;
  std::string out_;
  std::atomic<double> unwritten_ = 0;
  std::stop_source stop_;
  std::unique_ptr<bus::Parameters> parameters_;
  std::unique_ptr<viewer::Viewer> viewer_;
  std::thread thread_;
};

TEST_F(ViewerTest, TheNextOneGoesOnWhereThisOneWas) {
  start_streamer();
  trainer_.publish(stream::test::toy_model(100, 1));
  bus::Subscriber poses(peer_, {"viewer/pose"});
  ASSERT_TRUE(poses.wait_connected(bus_test::patience));
  // A quarter of its way, and it waits there.
  start_viewer({{"period_s", "100"}, {"path_start_s", "25"}, {"path_run", "false"}});
  const double before = told_angle(poses);
  EXPECT_NEAR(std::abs(before), M_PI / 2, 0.01);
  stop_viewer();
  const auto leaving = connect("viewer");
  ASSERT_TRUE(leaving->wait_connected(bus_test::patience));
  viewer::leave_place(*leaving, viewer_->place());
  const auto place = viewer::take_place(*connect("viewer"));
  ASSERT_TRUE(place);
  EXPECT_DOUBLE_EQ(place->path_s, 25);
  EXPECT_FALSE(viewer::take_place(*connect("viewer"))) << "once";
  while (poses.receive(0ms)) {
  }
  start_viewer({{"period_s", "100"}, {"path_start_s", "25"}, {"path_run", "false"}},
               viewer::Place{.path = place->path, .path_s = 50, .camera = place->camera});
  EXPECT_NEAR(std::cos(told_angle(poses) - before), 0, 0.01) << "a quarter further";
  stop_viewer();
  while (poses.receive(0ms)) {
  }
  start_viewer({{"period_s", "100"}, {"path_run", "false"}}, place);
  EXPECT_NEAR(std::cos(told_angle(poses) - before), 0, 0.01) << "which begins elsewhere: it is another path";
}

/// As the engine does, with what it is said to have drawn.
void answer(bus::Publisher& engine, const wire::ViewerProbe& asked, const SceneState& scene,
            const raster::Render& render, std::int64_t capture_ns = 0) {
  const Camera camera = from_wire(*asked.camera());
  const cv::Mat bgr = metrics::from_planes(render.color.data.data(), camera.width, camera.height, true);
  std::vector<std::uint8_t> rgba(std::size_t{camera.width} * camera.height * 4, 255);
  for (std::size_t i = 0; i < rgba.size() / 4; ++i) {
    for (std::size_t c = 0; c < 3; ++c) rgba[4 * i + c] = bgr.data[3 * i + 2 - c];
  }
  const bus::OutgoingTensor color{.name = "color",
                                  .shape = {camera.height, camera.width, 4},
                                  .type = bus::ElementType::U8,
                                  .inline_data = rgba.data()};
  engine.publish(
      topics::kCaptureProbe, {.capture_ns = capture_ns, .tensors = {color}}, [&](auto& builder, auto header) {
        return wire::CreateCaptureProbe(builder, header, asked.probe_id(), asked.camera(), to_wire(builder, scene, 1));
      });
}

Light daylight() {
  Light light;
  light.generation = 1;
  light.ambient_sh[0] = glm::vec3(2);
  light.sun_direction = glm::vec3(0, 1, 0);
  light.sun_irradiance = glm::vec3(1);
  return light;
}

TEST_F(ViewerTest, WritesFramesThatShowTheModel) {
  trainer_.publish_light(daylight());
  trainer_.publish(stream::test::toy_model(2000, 1));
  start_streamer();
  start_viewer({{"out", out_},
                {"frames", "1"},
                {"fps", "50"},
                {"width", "48"},
                {"height", "32"},
                {"path", "still"},
                {"threads", "1"}});
  const fs::path frame = fs::path(out_) / "frame_000000.png";
  ASSERT_TRUE(bus_test::eventually([&] { return fs::exists(frame); }));
  stop_viewer();
  const cv::Mat picture = metrics::read_png(frame);
  EXPECT_EQ(picture.cols, 48);
  EXPECT_EQ(picture.rows, 32);
  EXPECT_GT(cv::mean(picture)[1], 10) << "black";
  EXPECT_GT(viewer_->first_picture_ns(), 0);
}

TEST_F(ViewerTest, AWorldThatBecameEmptyIsShownEmpty) {
  trainer_.publish_light(daylight());
  trainer_.publish(stream::test::toy_model(2000, 1));
  start_streamer();
  start_viewer({{"out", out_}, {"frames", "1"}, {"fps", "50"}, {"width", "48"}, {"height", "32"}, {"path", "still"}});
  ASSERT_TRUE(bus_test::eventually([&] { return fs::exists(fs::path(out_) / "frame_000000.png"); }));
  trainer_.publish(stream::test::toy_model(0, 1));
  const auto last = [&] {
    int number = 0;
    while (fs::exists(fs::path(out_) / fmt::format("frame_{:06}.png", number + 1))) ++number;
    return number;
  };
  const auto is_empty = [&](int number) {
    const cv::Mat picture = metrics::read_png(fs::path(out_) / fmt::format("frame_{:06}.png", number));
    cv::Scalar mean, deviation;
    cv::meanStdDev(picture, mean, deviation);
    return !picture.empty() && cv::norm(deviation) < 1;
  };
  EXPECT_FALSE(is_empty(0));
  EXPECT_TRUE(bus_test::eventually([&] { return is_empty(last()); }));
}

TEST_F(ViewerTest, GoesOnWhereNoPictureCanBeWritten) {
  trainer_.publish_light(daylight());
  trainer_.publish(stream::test::toy_model(2000, 1));
  start_streamer();
  // A file where the folder should be refuses whatever the disk would.
  std::ofstream(out_) << "in the way";
  start_viewer({{"out", out_}, {"frames", "1"}, {"width", "48"}, {"height", "32"}, {"threads", "1"}});
  ASSERT_TRUE(bus_test::eventually([&] { return unwritten_ >= 2; }));
  fs::remove(out_);
  EXPECT_TRUE(bus_test::eventually([&] { return fs::exists(out_) && !fs::is_empty(out_); })) << "it did not go on";
  EXPECT_NE(parameters_->set("out", "/elsewhere", true), "") << "anybody on the bus could say where it writes";
}

TEST_F(ViewerTest, ComparesItsPictureWithTheEnginesOwn) {
  const Light light = daylight();
  const GaussiansBuffer model = stream::test::toy_model(2000, 1);
  trainer_.publish_light(light);
  trainer_.publish(model);
  start_streamer();
  bus::Subscriber probes(peer_, {"viewer/probe"}), qualities(peer_, {"viewer/quality"});
  bus::Publisher answers(peer_);
  start_viewer({{"out", out_},
                {"probe", "true"},
                {"probe_period_s", "0.1"},
                {"width", "64"},
                {"height", "64"},
                {"threads", "1"}});
  // The engine is played by a render of the very model: what is left is the stream's loss.
  const auto rasterizer = raster::make_cpu_rasterizer(1);
  std::uint64_t compared = 0;
  Camera probed;
  float psnr = 0, ssim = 0;
  std::int64_t first_picture_ns = 0;
  const bool answered = bus_test::eventually([&] {
    while (const auto message = probes.receive(1ms)) {
      const auto& body = message->root<wire::ViewerProbe>();
      const Camera camera = from_wire(*body.camera());
      probed = camera;
      raster::Render render;
      rasterizer->render(model.view(), camera, {light, {}}, {}, render);
      answer(answers, body, {.light = light, .objects = {}}, render);
    }
    while (const auto message = qualities.receive(1ms)) {
      const auto& body = message->root<wire::ViewerQuality>();
      compared = body.probe_id();
      psnr = body.psnr_db();
      ssim = body.ssim();
      first_picture_ns = body.first_picture_ns();
      EXPECT_EQ(body.gaussians(), 2000U);
    }
    return compared != 0;
  });
  ASSERT_TRUE(answered);
  EXPECT_GT(psnr, 40);
  EXPECT_GT(ssim, 0.99F);
  EXPECT_GT(first_picture_ns, 0);
  EXPECT_LE(first_picture_ns, bus::now_ns());
  EXPECT_TRUE(fs::exists(fs::path(out_) / ("probe_" + std::to_string(compared) + "_viewer.png")));
  const cv::Mat alpha = metrics::read_png(fs::path(out_) / ("probe_" + std::to_string(compared) + "_alpha.png"));
  ASSERT_EQ(alpha.size(), cv::Size(64, 64));
  raster::Render render;
  rasterizer->render(model.view(), probed, {light, {}}, {}, render);
  double most_off = 0;
  for (int i = 0; i < 64 * 64; ++i) {
    const double expected = 255.0 * render.alpha.data[static_cast<std::size_t>(i)];
    most_off = std::max(most_off, std::abs(alpha.at<cv::Vec3b>(i / 64, i % 64)[0] - expected));
  }
  EXPECT_LT(most_off, 12);
}

// The engine's picture of an instant comes later than what is seen of the lights a moment after it.
TEST_F(ViewerTest, ComparesAnInstantWithItsOwnShadows) {
  GaussiansBuffer model = stream::test::toy_model(2000, 1);
  SceneState lit{.light = daylight(), .objects = {}, .version = 10};
  lit.light.ambient_sh[0] = glm::vec3(0.2F);
  lit.light.sun_irradiance = glm::vec3(4);
  const std::int64_t begin_ns = bus::now_ns();
  trainer_.publish_scene(lit, begin_ns);
  const std::vector<std::uint32_t> index = trainer_.publish(model);
  const auto all_see = [&](std::uint8_t seen, std::uint64_t version) {
    const std::size_t indices = std::size_t{1} + *std::ranges::max_element(index);
    trainer_.publish_visibility(std::vector<std::uint8_t>(indices, seen), trainer_.generation(), version);
  };
  start_streamer();
  bus::Subscriber probes(peer_, {"viewer/probe"}), qualities(peer_, {"viewer/quality"});
  bus::Publisher answers(peer_);
  start_viewer({{"out", out_},
                {"frames", "1"},
                {"fps", "30"},
                {"path", "still"},
                {"probe", "true"},
                {"probe_period_s", "0.1"},
                {"width", "64"},
                {"height", "64"},
                {"threads", "1"}});
  int frame = 0;
  const auto brightness = [&] {
    while (fs::exists(fs::path(out_) / fmt::format("frame_{:06}.png", frame + 1))) ++frame;
    const cv::Mat picture = metrics::read_png(fs::path(out_) / fmt::format("frame_{:06}.png", frame));
    return picture.empty() ? -1 : cv::mean(picture)[1];
  };
  ASSERT_TRUE(bus_test::eventually([&] { return fs::exists(fs::path(out_) / "frame_000000.png"); }));
  // Each of a version of the scene of its own, of which the viewer has shown a picture before the next.
  double dark = 0;
  const auto is_dark = [&] {
    const double before = std::exchange(dark, brightness());
    return before > 0 && dark == before && dark < 40;
  };
  all_see(0, lit.version);
  ASSERT_TRUE(bus_test::eventually(is_dark)) << dark;
  const auto next = [&](std::uint8_t seen) {
    ++lit.version;
    trainer_.publish_scene(lit, begin_ns + static_cast<std::int64_t>(lit.version - 10) * 40'000'000);
    all_see(seen, lit.version);
  };
  next(255);
  ASSERT_TRUE(bus_test::eventually([&] { return brightness() > dark + 30; })) << dark;
  next(0);
  ASSERT_TRUE(bus_test::eventually(is_dark)) << dark;

  // The engine is played by a render of the model as its Gaussians were lit then.
  const auto rasterizer = raster::make_cpu_rasterizer(1);
  float psnr = 0;
  const auto compared = [&](std::uint64_t version, float seen) {
    std::uint64_t asked = 0;
    psnr = 0;
    const bool answered = bus_test::eventually([&] {
      while (const auto message = probes.receive(1ms)) {
        if (asked != 0) continue;
        const auto& body = message->root<wire::ViewerProbe>();
        asked = body.probe_id();
        GaussiansBuffer then = model;
        std::ranges::fill(then.visibility, seen);
        SceneState scene = lit;
        scene.version = version;
        raster::Render render;
        rasterizer->render(then.view(), from_wire(*body.camera()), scene, {}, render);
        answer(answers, body, scene, render, begin_ns);
      }
      while (const auto message = qualities.receive(1ms)) {
        const auto& body = message->root<wire::ViewerQuality>();
        if (body.probe_id() == asked) psnr = body.psnr_db();
      }
      return psnr > 0;
    });
    return answered;
  };
  ASSERT_TRUE(compared(11, 1));
  EXPECT_GT(psnr, 40) << "with another instant's shadows";
  ASSERT_TRUE(compared(12, 0));
  EXPECT_GT(psnr, 40) << "what is newest did not come back";
}

TEST_F(ViewerTest, ItsPathIsSteeredWhileItRuns) {
  const std::string way = directory_.path() + "/way.txt", record = directory_.path() + "/record.txt";
  std::ofstream(way) << "0 1 0\n2 1 0\n";
  start_streamer();
  bus::Subscriber poses(peer_, {"viewer/pose"});
  // The eye's x once it has held still for two poses, which tells where the path stands.
  const auto rest_at = [&](float x) {
    float before = -1;
    return bus_test::eventually([&] {
      const auto message = poses.receive(20ms);
      if (!message) return false;
      const float now = from_wire(*message->root<wire::ViewerPose>().camera()).world_from_camera.translation.x;
      return std::abs(std::exchange(before, now) - x) < 1e-4F && std::abs(now - x) < 1e-4F;
    });
  };
  start_viewer({{"path", "walk"},
                {"path_file", way},
                {"path_run", "false"},
                {"speed_m_s", "20"},
                {"record_file", record},
                {"threads", "1"}});
  EXPECT_TRUE(rest_at(0));
  ASSERT_EQ(parameters_->set("path_run", "true", true), "");
  EXPECT_TRUE(rest_at(2));
  ASSERT_EQ(parameters_->set("path_run", "false", true), "");
  ASSERT_EQ(parameters_->set("path_start_s", "0.05", true), "");
  EXPECT_TRUE(rest_at(1));
  ASSERT_EQ(parameters_->set("path_file", directory_.path() + "/none", true), "");
  ASSERT_EQ(parameters_->set("path_start_s", "0", true), "");
  EXPECT_TRUE(rest_at(1)) << "a file that cannot be read leaves it on its way";
  stop_viewer();
  std::vector<float> seen;
  const auto legs = viewer::read_path_poses(record);
  for (const viewer::TimedPose& pose : legs.front()) {
    const float x = pose.world_from_camera.translation.x;
    if (seen.empty() || std::abs(seen.back() - x) > 1e-3F) seen.push_back(x);
  }
  ASSERT_GE(seen.size(), 3U);
  EXPECT_NEAR(seen.front(), 0, 1e-3F);
  EXPECT_NEAR(*std::ranges::max_element(seen), 2, 1e-3F);
  EXPECT_NEAR(seen.back(), 1, 1e-3F);
}

TEST_F(ViewerTest, APathThatCannotBeReadIsAClearError) {
  start_streamer();
  EXPECT_THROW(start_viewer({{"path", "walk"}, {"path_file", directory_.path() + "/none"}}), bus::Error);
}

TEST_F(ViewerTest, AWindowWithoutADisplayIsAClearError) {
  ::unsetenv("DISPLAY");
  ::unsetenv("WAYLAND_DISPLAY");
  start_streamer();
  try {
    start_viewer({{"window", "true"}});
    FAIL();
  } catch (const bus::Error& error) {
    EXPECT_NE(std::string(error.what()).find("display"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace splatbus::stream_test
