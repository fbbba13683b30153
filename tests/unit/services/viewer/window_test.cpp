// Under a person's keys and mouse.
#include "gaussians/player.h"
#include "splats/file.h"
#include "stream/packet_log.h"
#include "window_fixture.h"

namespace splatbus::stream_test {
namespace {

/// Pictures that come ready made, and splats drawn in the window.
class WindowOfBothKinds : public WindowTest, public testing::WithParamInterface<const char*> {};

TEST_P(WindowOfBothKinds, FiguresAndMenuComeAndGo) {
  start({GetParam()});
  ASSERT_TRUE(soon([&] { return figures_text() > 500; })) << figures_text() << log();
  // A notice of the first seconds reaches into the menu's place.
  EXPECT_TRUE(soon([&] { return menu_text() < 100; })) << menu_text();
  open_menu();
  Display::act("key i");
  EXPECT_TRUE(soon([&] { return figures_text() < 100; })) << figures_text();
  Display::act("key Escape");
  EXPECT_TRUE(soon([&] { return menu_text() < 100; })) << menu_text();
  Display::act("key i");
  EXPECT_TRUE(soon([&] { return figures_text() > 500; })) << "gone for ever";
  Display::act("key Escape");
  EXPECT_EQ(viewer_->wait(), 0) << log();
}

TEST_P(WindowOfBothKinds, ThePictureIsSavedWithoutWhatIsOverIt) {
  start({GetParam()});
  open_menu();
  press("Right");  // of "Show all", where it begins
  const std::string file = save(".png", [] { Display::act("key space"); });
  const cv::Mat picture = metrics::read_png(file);
  ASSERT_EQ(picture.size(), cv::Size(kWidth, kHeight));
  EXPECT_TRUE(is_seen(save_resting_picture())) << "upside down, or another";
  EXPECT_LT(count_text(picture, kMenu) + count_text(picture, kFigures), 100);
}

TEST_P(WindowOfBothKinds, QualityAndBackgroundAreAsChosen) {
  start({GetParam()});
  const cv::Mat fine = save_resting_picture();
  open_menu();
  press_times("Down", 3);  // full screen, figures, quality
  press("space");
  press_times("Down", 3);
  press("space");
  const auto detail = [](const cv::Mat& picture) {
    return cv::norm(picture.colRange(1, picture.cols), picture.colRange(0, picture.cols - 1), cv::NORM_L2);
  };
  cv::Mat coarse;
  EXPECT_TRUE(soon([&] {
    coarse = save_picture();
    return detail(coarse) < 0.8 * detail(fine);
  }));
  EXPECT_LT(cv::norm(fine, coarse, cv::NORM_L1) / fine.total(), 30) << "another view";
  EXPECT_LT(cv::mean(coarse.row(0))[1], 5);
  press_times("Down", 3);
  press("space");
  press_times("Down", 3);
  press("space");
  EXPECT_TRUE(soon([&] { return cv::mean(save_picture().row(0))[1] > 250; }));
}

INSTANTIATE_TEST_SUITE_P(, WindowOfBothKinds, testing::Values("probe=true", "opengl=true"),
                         [](const auto& of) { return std::string(of.param) == "probe=true" ? "Pictures" : "Splats"; });

TEST_F(WindowTest, TheBudgetIsAsChosenAndTheModelIsSaved) {
  const std::string packets = directory_.path() + "/packets";
  start({"max_gaussians=3000", "packet_log=" + packets});
  open_menu();
  press_times("Down", 7);  // full screen, figures, quality, Gaussians, rate, background, model
  // Of a model that is on its way there is no file: it is asked again.
  const auto count = [&](const std::string& extension) {
    const auto before = saved(extension).size();
    EXPECT_TRUE(soon([&] {
      Display::act("key space");
      return bus_test::eventually([&] { return saved(extension).size() > before; }, 2s);
    })) << log();
    auto files = saved(extension);
    EXPECT_FALSE(files.empty());
    std::ranges::sort(files, {}, [](const std::string& file) { return fs::last_write_time(file); });
    return files.empty() ? 0 : splats::read_file(files.back()).gaussians.count();
  };
  const std::size_t few = count(".ply");
  EXPECT_GT(few, 0U);
  EXPECT_LE(few, 3000U);
  press_times("Up", 3);
  press("space");
  press("space");
  press_times("Down", 3);
  EXPECT_TRUE(soon([&] { return count(".ply") == shown_; })) << log();
  press_times("Right", 2);
  EXPECT_EQ(count(".spz"), shown_);
  press_times("Up", 2);
  press("space");
  press_times("Down", 3);
  press("space");
  // What the streamer says that it keeps to.
  EXPECT_TRUE(soon([&] {
    stream::PacketLogReader reader(packets);
    std::uint32_t kbps = 0;
    while (const auto message = reader.next()) {
      const auto packet = stream::ParsedPacket::parse(message->packet, message->payload);
      if (packet.body() == wire::Body::Keepalive) kbps = packet.root().body_as_Keepalive()->kbps();
    }
    return kbps == 5000;
  }));
}

TEST_F(WindowTest, AKeyCountsAsOftenAsItIsPressedDuringALongPicture) {
  start({"probe=true"});
  open_menu();
  press_times("Down", 3);
  const cv::Mat third = display_->screen()(kMenu).clone();
  press_times("Up", 3);
  viewer_->send(SIGSTOP);
  for (int i = 0; i < 3; ++i) Display::act("key Down");
  viewer_->send(SIGCONT);
  EXPECT_TRUE(soon([&] { return !differ(display_->screen()(kMenu), third); }));
}

TEST_F(WindowTest, AKeyHeldDuringALongPictureCountsOnce) {
  start({"probe=true"});
  open_menu();
  press("Down");
  press("Down");
  const cv::Mat second = display_->screen()(kMenu).clone();
  press("Up");
  viewer_->send(SIGSTOP);
  Display::act("keydown Down");
  std::this_thread::sleep_for(2s);  // the display repeats it meanwhile
  Display::act("keyup Down");
  viewer_->send(SIGCONT);
  EXPECT_TRUE(soon([&] { return !differ(display_->screen()(kMenu), second); }));
  std::this_thread::sleep_for(1s);  // as long as repetitions that wait would take
  EXPECT_FALSE(differ(display_->screen()(kMenu), second));
}

// As where a picture takes longer than what a key is held to be repeated: it stands still between press and release.
TEST_F(WindowTest, AKeyLetGoDuringALongPictureCountsOnce) {
  start({"probe=true"});
  open_menu();
  press("Down");
  const cv::Mat second = display_->screen()(kMenu).clone();
  press("Down");
  const cv::Mat third = display_->screen()(kMenu).clone();
  bool held_briefly = false;
  for (int i = 0; i < 20 && !held_briefly; ++i) {
    press("Up");
    ASSERT_FALSE(differ(display_->screen()(kMenu), second));
    const auto begin = std::chrono::steady_clock::now();
    Display::act("keydown Down");
    ASSERT_TRUE(soon([&] { return differ(display_->screen()(kMenu), second); })) << log();
    viewer_->send(SIGSTOP);
    Display::act("keyup Down");
    held_briefly = std::chrono::steady_clock::now() - begin < 150ms;
    std::this_thread::sleep_for(600ms);
    viewer_->send(SIGCONT);
    std::this_thread::sleep_for(600ms);
    if (held_briefly) {
      EXPECT_FALSE(differ(display_->screen()(kMenu), third)) << "went on without the key";
    } else {
      // It was repeated, as it ought to be.
      for (int k = 0; k < 10 && differ(display_->screen()(kMenu), third); ++k) press("Up");
    }
  }
  if (!held_briefly) GTEST_SKIP() << "this machine is too slow to say";
}

TEST_F(WindowTest, WhatIsMeantForTheMenuDoesNotSteer) {
  start();
  const Rigid before = resting_pose();
  open_menu();
  Display::act("keydown w sleep 0.5 keyup w");
  Display::act("mousemove 400 400 mousedown 1 sleep 0.1 mousemove 480 440 sleep 0.3 mouseup 1 click 4");
  EXPECT_EQ(resting_pose(), before);
  Display::act("mousemove 240 300 mousedown 1 sleep 0.1 mousemove 200 320 sleep 0.3 mouseup 1");
  const Rigid turned = resting_pose();
  EXPECT_NE(turned, before);
  EXPECT_GT(menu_text(), 2000);
  Display::act("keydown w sleep 0.5 keyup w");
  EXPECT_NE(resting_pose(), turned) << "a click into the picture gives it the keys";
}

TEST_F(WindowTest, ThePlayerIsFollowedAndAllIsShown) {
  SceneState scene{.light = {.generation = 2}, .objects = {}, .version = 9};
  scene.light.ambient_sh[0] = glm::vec3(1);
  const Camera player = look_at({1, 1.5F, 2}, {0, 0.2F, 0}, 64, 64, 1);
  scene.objects[kPlayerId].rigid = player.world_from_camera;
  trainer_.publish_scene(scene);
  start();
  open_menu();
  press_times("Down", 3);
  press("space");
  const auto eye = [&] { return resting_pose().translation; };
  EXPECT_LT(glm::distance(eye(), player.world_from_camera.translation), 0.01F);
  press_times("Up", 3);
  Display::act("key space");
  EXPECT_GT(glm::distance(eye(), player.world_from_camera.translation), 0.5F);
  EXPECT_GT(cv::mean(display_->screen()(kPicture))[1], 1);
}

TEST_F(WindowTest, WhoAskedForAPlayerBeforeThereIsOneStaysWhereHeIs) {
  start();
  const Rigid before = resting_pose();
  Display::act("key g");
  ASSERT_TRUE(soon([&] { return log().find("offers no player") != std::string::npos; })) << log();
  SceneState scene{.light = {.generation = 2}, .objects = {}, .version = 9};
  scene.light.ambient_sh[0] = glm::vec3(1);
  scene.objects[kPlayerId].rigid = look_at({1, 1.5F, 2}, {0, 0.2F, 0}, 64, 64, 1).world_from_camera;
  trainer_.publish_scene(scene);
  EXPECT_EQ(resting_pose(), before);
  open_menu();
  press_times("Down", 3);
  EXPECT_EQ(resting_pose(), before);
  press("space");
  EXPECT_LT(glm::distance(resting_pose().translation, {1, 1.5F, 2}), 0.01F) << "the player had come";
}

TEST_F(WindowTest, FullScreenComesAndGoes) {
  start();
  open_menu();
  press("Down");
  Display::act("key space");
  EXPECT_TRUE(soon([&] { return save_picture().size() == cv::Size(800, 640); }));
  Display::act("key v");
  EXPECT_TRUE(soon([&] { return save_picture().size() == cv::Size(kWidth, kHeight); }));
}

}  // namespace
}  // namespace splatbus::stream_test
