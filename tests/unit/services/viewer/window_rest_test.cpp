// Pictures that rest: what is seen once nothing moves any more.
#include "viewer/stream_client.h"
#include "window_fixture.h"

namespace splatbus::stream_test {
namespace {

class RestingWindow : public WindowTest {
 protected:
  /// What has faded in is there to the full.
  void expect_settled() {
    const cv::Mat resting = save_resting_picture(), anew = save_picture_drawn_anew();
    ASSERT_EQ(resting.size(), anew.size());
    EXPECT_EQ(cv::norm(resting, anew, cv::NORM_INF), 0);
  }
};

TEST_F(RestingWindow, ShowsWhatHasFadedInToTheFull) {
  start({"opengl=true", "draw=quads"});
  expect_settled();
}

TEST_F(RestingWindow, ShowsWhatHasFadedInToTheFullOfAReplay) {
  viewer::ClientOptions options = client_options("recorder");
  options.packet_log = directory_.path() + "/packets";
  {
    viewer::StreamClient client(options);
    ASSERT_TRUE(poll_until([&] { return client.replica().count() == kGaussians; }, client));
  }
  start({"opengl=true", "draw=quads"}, {"--replay", options.packet_log});
  expect_settled();
}

TEST_F(RestingWindow, SaysThatTheConnectionIsLost) {
  start({"opengl=true"});
  const cv::Mat picture = save_resting_picture();
  ASSERT_TRUE(soon([&] { return count_text(display_->screen(), kNotice) < 10; })) << "the notice of the saved picture";
  streamer_.reset();
  EXPECT_TRUE(soon([&] { return count_text(display_->screen(), kNotice) > 100; })) << log();
  EXPECT_TRUE(is_seen(picture));
  start_streamer();
  EXPECT_TRUE(soon([&] { return count_text(display_->screen(), kNotice) < 10; })) << log();
}

class RestingWindowOfBothKinds : public RestingWindow, public testing::WithParamInterface<const char*> {};

TEST_P(RestingWindowOfBothKinds, IsPaintedAnewWhereAnotherWasOverIt) {
  start({GetParam()});
  Display::act("key i");
  ASSERT_TRUE(soon([&] { return figures_text() < 100; })) << figures_text();
  const cv::Mat picture = save_resting_picture();
  ASSERT_TRUE(soon([&] { return count_text(display_->screen(), kNotice) < 10; })) << "the notice of the saved picture";
  Display::act("search --name splatbus windowunmap");
  ASSERT_TRUE(soon([&] { return differ(picture(kPicture), display_->screen()(kPicture)); })) << "it is still seen";
  Display::act("search --name splatbus windowmap");
  EXPECT_TRUE(is_seen(picture));
}

INSTANTIATE_TEST_SUITE_P(, RestingWindowOfBothKinds, testing::Values("probe=true", "opengl=true"),
                         [](const auto& of) { return std::string(of.param) == "probe=true" ? "Pictures" : "Splats"; });

}  // namespace
}  // namespace splatbus::stream_test
