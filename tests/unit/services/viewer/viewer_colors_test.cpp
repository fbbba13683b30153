// Colours that are played out, in the pictures that a viewer writes.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <utility>

#include "../streamer/stream_fixture.h"
#include "bus/clock.h"
#include "metrics/image_io.h"
#include "viewer/viewer.h"

namespace splatbus::stream_test {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;

constexpr std::int64_t kApartNs = 200'000'000;  // scenes, by the engine's clock, however late they come

class ViewerColorsTest : public StreamTest {
 protected:
  ViewerColorsTest() : out_(directory_.path() + "/out"), parameters_(bus::Parameters::declare<viewer::Options>()) {
    for (const auto& [name, value] : std::vector<std::pair<std::string, std::string>>{{"out", out_},
                                                                                      {"frames", "1"},
                                                                                      {"fps", "60"},
                                                                                      {"width", "32"},
                                                                                      {"height", "24"},
                                                                                      {"path", "still"},
                                                                                      {"opengl", "true"},
                                                                                      {"draw", "quads"}}) {
      EXPECT_EQ(parameters_.set(name, value, false), "");
    }
  }
  ~ViewerColorsTest() override {
    stop_.request_stop();
    if (thread_.joinable()) thread_.join();
  }

  void publish_light(float ambient, float sun) {
    SceneState scene{.light = {}, .objects = {}, .version = ++version_};
    scene.light.generation = light_ += ambient != ambient_ ? 1 : 0;
    scene.light.ambient_sh[0] = glm::vec3(ambient);
    scene.light.sun_irradiance = glm::vec3(sun);
    ambient_ = ambient;
    trainer_.publish_scene(scene, capture_ns_ += kApartNs);
  }
  void start_viewer() {
    thread_ = std::thread([this] {  // the context is of the thread that makes it
      viewer::Viewer viewer(parameters_, {.name = "viewer",
                                          .endpoint = endpoint(),
                                          .stop = stop_.get_token(),
                                          .counter = [](const auto&, double) {},
                                          .detail = [](const auto&) {}});
      viewer.run();
    });
  }
  /// How bright the pictures are that have come since, once none comes any more.
  std::vector<double> levels() {
    const auto picture = [&](int k) { return fs::path(out_) / fmt::format("frame_{:06}.png", k); };
    int end = pictures_;
    auto last = std::chrono::steady_clock::now();
    EXPECT_TRUE(bus_test::eventually([&] {
      for (; fs::exists(picture(end)); ++end) last = std::chrono::steady_clock::now();
      return end > pictures_ && std::chrono::steady_clock::now() - last > 1s;
    }));
    std::vector<double> levels;
    for (; pictures_ < end; ++pictures_) levels.push_back(cv::mean(metrics::read_png(picture(pictures_)))[1]);
    return levels;
  }

  std::string out_;
  bus::Parameters parameters_;
  std::uint64_t version_ = 100, light_ = 100;
  float ambient_ = -1;
  std::int64_t capture_ns_ = bus::now_ns();
  int pictures_ = 0;
  std::stop_source stop_;
  std::thread thread_;
};

TEST_F(ViewerColorsTest, GoFromTheLightOfOneSceneToThatOfTheNext) {
  publish_light(0.2F, 0);
  trainer_.publish(stream::test::toy_model(500, 1));
  start_streamer();
  start_viewer();
  double before = levels().back();
  int gradual = 0;
  for (int k = 0; gradual < 3 && k < 20; ++k) {  // a loaded machine draws few pictures on the way
    const double sign = k % 2 == 0 ? 1 : -1;
    publish_light(k % 2 == 0 ? 2.2F : 0.2F, 0);
    int between = 0;
    double last = before;
    for (const double level : levels()) {
      EXPECT_GT(sign * (level - last), -0.1) << "it goes one way";
      between += sign * (level - last) > 0.1 ? 1 : 0;
      last = level;
    }
    EXPECT_GT(sign * (last - before), 20);
    before = last;
    gradual += between > 3 ? 1 : 0;
  }
  EXPECT_EQ(gradual, 3);
}

// Nothing moves in such a scene, and its shadows come after it.
TEST_F(ViewerColorsTest, OfShadowsThatAreOnTheirWayAreSeenToTheirEnd) {
  publish_light(0.5F, 3);
  const std::vector<std::uint32_t> index = trainer_.publish(stream::test::toy_model(500, 1));
  start_streamer({{"visibility_hz", "100"}});
  start_viewer();
  (void)levels();
  const auto see = [&](std::uint8_t seen) {
    publish_light(0.5F, 3);
    trainer_.publish_visibility(std::vector<std::uint8_t>(*std::ranges::max_element(index) + 1, seen),
                                trainer_.generation(), version_);
    return levels().back();
  };
  const double dark = see(0), bright = see(255);
  EXPECT_GT(bright, dark + 20);
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(see(0), dark, 0.5);
    EXPECT_NEAR(see(255), bright, 0.5);
  }
}

}  // namespace
}  // namespace splatbus::stream_test
