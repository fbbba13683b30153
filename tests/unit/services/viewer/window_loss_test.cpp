// A graphics device that is reset under the window.
#include <fstream>

#include "viewer/stream_client.h"
#include "window_fixture.h"

namespace splatbus::stream_test {
namespace {

class LostWindow : public WindowTest {
 protected:
  LostWindow() : lost_(directory_.path() + "/lost") {
    ::setenv("SPLATBUS_LOST_CONTEXT", lost_.c_str(), 1);
    preloaded_ = SPLATBUS_LOST_CONTEXT_LIBRARY;
  }
  ~LostWindow() override { ::unsetenv("SPLATBUS_LOST_CONTEXT"); }
  void SetUp() override {
#ifdef SPLATBUS_SANITIZED
    GTEST_SKIP() << "a sanitizer has to be the first library of a process";
#endif
  }

  void lose() {
    std::ofstream{lost_};
  }
  [[nodiscard]] bool heard() const {
    return !fs::exists(lost_);
  }
  /// It stands all the while, and is the same afterwards.
  void expect_to_survive() {
    Display::act("key i");
    ASSERT_TRUE(soon([&] { return figures_text() < 100; })) << figures_text();
    const cv::Mat picture = save_resting_picture();
    ASSERT_TRUE(is_seen(picture));
    std::this_thread::sleep_for(1s);  // a picture that rests is remembered
    lose();
    std::chrono::steady_clock::time_point heard_at{};
    EXPECT_TRUE(soon([&] {
      EXPECT_GT(cv::mean(display_->screen()(kPicture))[1], 1);
      if (!heard()) return false;
      if (heard_at == std::chrono::steady_clock::time_point{}) heard_at = std::chrono::steady_clock::now();
      return std::chrono::steady_clock::now() - heard_at > 2s;
    })) << log();
    EXPECT_TRUE(soon([&] { return log().find("the graphics device was reset") != std::string::npos; })) << log();
    EXPECT_TRUE(is_seen(picture)) << log();
    Display::act("search --sync --name splatbus windowfocus --sync mousemove 20 300");
    EXPECT_EQ(cv::norm(save_picture_drawn_anew(), picture, cv::NORM_INF), 0) << "drawn from all that there was";
  }

  std::string lost_;
};

class LostWindowOfBothKinds : public LostWindow, public testing::WithParamInterface<const char*> {};

TEST_P(LostWindowOfBothKinds, ShowsTheSameAgainFromTheSamePlace) {
  start({GetParam(), "draw=quads"});
  Display::act("mousemove 240 300 mousedown 1 sleep 0.1 mousemove 200 320 sleep 0.3 mouseup 1 mousemove 20 300");
  const Rigid pose = resting_pose();
  expect_to_survive();
  open_menu();
  EXPECT_EQ(resting_pose(), pose);
}

INSTANTIATE_TEST_SUITE_P(, LostWindowOfBothKinds, testing::Values("probe=true", "opengl=true"),
                         [](const auto& of) { return std::string(of.param) == "probe=true" ? "Pictures" : "Splats"; });

TEST_F(LostWindow, ShowsAReplayAgain) {
  viewer::ClientOptions options = client_options("recorder");
  options.packet_log = directory_.path() + "/packets";
  {
    viewer::StreamClient client(options);
    ASSERT_TRUE(poll_until([&] { return client.replica().count() == kGaussians; }, client));
  }
  start({"opengl=true", "draw=quads"}, {"--replay", options.packet_log});
  expect_to_survive();
}

TEST_F(LostWindow, EndsWhereTheDeviceIsLostAgainAndAgain) {
  start({"opengl=true", "draw=quads"});
  const auto renewed = [&] {
    const std::string text = log();
    int count = 0;
    for (std::size_t at = 0; (at = text.find("there is another context", at)) != std::string::npos; ++at) ++count;
    return count;
  };
  for (int k = 0; k < 4; ++k) {
    ASSERT_TRUE(soon([&] { return renewed() == k; })) << k << log();
    lose();
    ASSERT_TRUE(soon([&] { return heard(); })) << k << log();
  }
  EXPECT_EQ(viewer_->wait(), 1) << log();
}

}  // namespace
}  // namespace splatbus::stream_test
