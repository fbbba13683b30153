// The program with its window on a display, under a person's keys and mouse, before a streamer.
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>

#include "../../bus/child_process.h"
#include "../streamer/stream_fixture.h"
#include "display.h"
#include "gaussians/player.h"
#include "metrics/image_io.h"
#include "splats/file.h"
#include "stream/packet_log.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;
using display_test::count_text;
using display_test::Display;

constexpr int kWidth = 640, kHeight = 580;
constexpr std::size_t kGaussians = 6000;
const cv::Rect kFigures(0, 0, 180, 200), kMenu(280, 0, 360, 560), kPicture(190, 100, 70, 400);

/// A wait for what takes a picture or two.
bool soon(const std::function<bool()>& condition) {
  return bus_test::eventually(condition, 20s);
}

class WindowTest : public StreamTest {
 protected:
  WindowTest() : out_(directory_.path() + "/out"), peer_(connect("peer")), poses_(peer_, {"viewer/pose"}) {
    ::setenv("LIBGL_ALWAYS_SOFTWARE", "1", 1);
    Light light{.generation = 1};
    light.ambient_sh[0] = glm::vec3(1);
    trainer_.publish_light(light);
    const GaussiansBuffer model = stream::test::toy_model(kGaussians, 1);
    trainer_.publish(model);
    shown_ = splats::BakedModel(model.view(), {.light = light, .objects = {}}).count();
    start_streamer();
    display_.emplace(directory_.path());
  }

  /// SPLATBUS_WINDOW_PICTURES=FOLDER keeps the last of the screen, and what was saved.
  ~WindowTest() override {
    const char* folder = std::getenv("SPLATBUS_WINDOW_PICTURES");
    if (!folder) return;
    std::string name = testing::UnitTest::GetInstance()->current_test_info()->name();
    std::ranges::replace(name, '/', '_');
    fs::create_directories(folder);
    metrics::write_png(fs::path(folder) / (name + ".png"), display_->screen());
    if (fs::exists(out_))
      fs::copy(out_, fs::path(folder) / name, fs::copy_options::recursive | fs::copy_options::overwrite_existing);
  }

  /// Until something is seen.
  void start(std::vector<std::string> more = {}) {
    std::vector<std::string> arguments{"--connect",
                                       endpoint(),
                                       "--window",
                                       "--set",
                                       "out=" + out_,
                                       "--set",
                                       "width=" + std::to_string(kWidth),
                                       "--set",
                                       "height=" + std::to_string(kHeight),
                                       "--set",
                                       "path=still",
                                       "--set",
                                       "threads=1"};
    for (const std::string& parameter : more) {
      arguments.emplace_back("--set");
      arguments.push_back(parameter);
    }
    viewer_.emplace("splatbus-viewer", arguments, directory_.path() + "/log");
    ASSERT_TRUE(soon([&] { return cv::mean(display_->screen()(kPicture))[1] > 1; })) << log();
    Display::act("search --sync --name splatbus windowfocus --sync mousemove 20 300");
  }

  [[nodiscard]] std::string log() const { return bus_test::read_text(directory_.path() + "/log"); }
  [[nodiscard]] int figures_text() const { return count_text(display_->screen(), kFigures); }
  [[nodiscard]] int menu_text() const { return count_text(display_->screen(), kMenu); }

  void open_menu() {
    Display::act("key m");
    ASSERT_TRUE(soon([&] { return menu_text() > 2000; })) << menu_text() << log();
  }
  /// A key that changes what the menu shows, and what it shows then stands.
  void press(const std::string& key) {
    const cv::Mat before = display_->screen()(kMenu).clone();
    Display::act("key " + key);
    EXPECT_TRUE(soon([&] { return differ(display_->screen()(kMenu), before); })) << "nothing after " << key;
    cv::Mat last;
    EXPECT_TRUE(soon([&] {
      std::this_thread::sleep_for(150ms);
      const cv::Mat now = display_->screen()(kMenu).clone();
      return !differ(std::exchange(last, now), now);
    })) << key;
  }
  void press_times(const std::string& key, int times) {
    for (int i = 0; i < times; ++i) press(key);
  }
  static bool differ(const cv::Mat& a, const cv::Mat& b) { return a.empty() || cv::norm(a, b, cv::NORM_INF) > 0; }

  [[nodiscard]] std::vector<std::string> saved(const std::string& extension) const {
    std::vector<std::string> files;
    if (!fs::exists(out_)) return files;
    for (const auto& entry : fs::directory_iterator(out_)) {
      if (entry.path().extension() == extension) files.push_back(entry.path().string());
    }
    return files;
  }
  /// Saves once more by `act`, and returns the file.
  std::string save(const std::string& extension, const std::function<void()>& act) {
    const auto before = saved(extension);
    std::string found;
    act();
    EXPECT_TRUE(soon([&] {
      for (const std::string& file : saved(extension)) {
        if (std::ranges::find(before, file) == before.end()) found = file;
      }
      return !found.empty();
    })) << log();
    return found;
  }
  [[nodiscard]] cv::Mat save_picture() {
    return metrics::read_png(save(".png", [] { Display::act("key p"); }));
  }
  /// Once nothing of it changes any more.
  cv::Mat save_resting_picture() {
    cv::Mat now;
    EXPECT_TRUE(soon([&] {
      std::this_thread::sleep_for(300ms);
      const cv::Mat before = std::exchange(now, save_picture());
      return before.size() == now.size() && !differ(before, now);
    }));
    return now;
  }

  /// Where the camera is once it rests.
  Rigid resting_pose() {
    Rigid pose, before;
    EXPECT_TRUE(soon([&] {
      while (const auto message = poses_.receive(1ms)) {
        pose = from_wire(*message->root<wire::ViewerPose>().camera()).world_from_camera;
      }
      std::this_thread::sleep_for(600ms);
      return std::exchange(before, pose) == pose && !(pose == Rigid{});
    }));
    return pose;
  }

  std::size_t shown_ = 0;  ///< Gaussians, without those of objects that are not there
  std::string out_;
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber poses_;
  std::optional<Display> display_;
  std::optional<bus_test::ChildProcess> viewer_;
};

/// Pictures that come ready made, and splats drawn in the window.
class WindowOfBothKinds : public WindowTest, public testing::WithParamInterface<const char*> {};

TEST_P(WindowOfBothKinds, FiguresAndMenuComeAndGo) {
  start({GetParam()});
  ASSERT_TRUE(soon([&] { return figures_text() > 500; })) << figures_text() << log();
  EXPECT_LT(menu_text(), 100);
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
  const cv::Mat resting = save_resting_picture();
  EXPECT_EQ(cv::norm(resting(kPicture), display_->screen()(kPicture), cv::NORM_INF), 0) << "upside down, or another";
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
  const cv::Mat coarse = save_resting_picture();
  EXPECT_LT(cv::norm(fine, coarse, cv::NORM_L1) / fine.total(), 30) << "another view";
  const auto detail = [](const cv::Mat& picture) {
    return cv::norm(picture.colRange(1, picture.cols), picture.colRange(0, picture.cols - 1), cv::NORM_L2);
  };
  EXPECT_LT(detail(coarse), 0.8 * detail(fine));
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
  const auto count = [&](const std::string& extension) {
    return splats::read_file(save(extension, [] { Display::act("key space"); })).gaussians.count();
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
