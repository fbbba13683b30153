#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "../../bus/child_process.h"
#include "../streamer/stream_fixture.h"
#include "display.h"
#include "metrics/image_io.h"
#include "splats/baked_model.h"
#include "wire/viewer_generated.h"

namespace splatbus::stream_test {

using namespace std::chrono_literals;
namespace fs = std::filesystem;
using display_test::count_text;
using display_test::Display;

inline constexpr int kWidth = 640, kHeight = 580;
inline constexpr std::size_t kGaussians = 6000;
inline const cv::Rect kFigures(0, 0, 180, 200), kMenu(280, 0, 360, 560), kPicture(190, 100, 70, 400);
inline const cv::Rect kNotice(120, 545, 400, 30);

/// A wait for what takes a picture or two.
inline bool soon(const std::function<bool()>& condition) {
  return bus_test::eventually(condition, 20s);
}

/// The program with its window on a display, before a streamer.
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

  /// `from`: --connect ENDPOINT where it says nothing else.
  void launch(const std::vector<std::string>& more = {}, std::vector<std::string> from = {}) {
    if (from.empty()) from = {"--connect", endpoint()};
    std::vector<std::string> arguments = std::move(from);
    arguments.emplace_back("--window");
    const auto set = [&](const std::string& parameter) {
      arguments.emplace_back("--set");
      arguments.push_back(parameter);
    };
    set("out=" + out_);
    set("width=" + std::to_string(kWidth));
    set("height=" + std::to_string(kHeight));
    set("path=still");
    set("threads=1");
    for (const std::string& parameter : more) set(parameter);
    if (!preloaded_.empty()) ::setenv("LD_PRELOAD", preloaded_.c_str(), 1);
    viewer_.emplace("splatbus-viewer", arguments, directory_.path() + "/log");
    ::unsetenv("LD_PRELOAD");
  }
  /// Until something is seen.
  void start(const std::vector<std::string>& more = {}, std::vector<std::string> from = {}) {
    launch(more, std::move(from));
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
  /// Whether it is on the screen, without what is over it; the server may be at writing that.
  [[nodiscard]] bool is_seen(const cv::Mat& picture) const {
    return soon([&] { return !differ(picture(kPicture), display_->screen()(kPicture)); });
  }
  /// Of a picture that is drawn once more from all that is there by now.
  cv::Mat save_picture_drawn_anew() {
    const auto resize = [&](int width, int height) {
      Display::act("search --name splatbus windowsize " + std::to_string(width) + " " + std::to_string(height));
      EXPECT_TRUE(soon([&] { return save_picture().size() == cv::Size(width, height); })) << log();
    };
    resize(kWidth - 40, kHeight - 40);
    resize(kWidth, kHeight);
    return save_resting_picture();
  }

  /// Where the camera is once it rests: it says so each second then.
  Rigid resting_pose() {
    constexpr int kTimes = 3;
    while (poses_.receive(1ms)) {
    }
    Rigid pose;
    int times = 0;
    EXPECT_TRUE(soon([&] {
      while (const auto message = poses_.receive(1ms)) {
        const Rigid next = from_wire(*message->root<wire::ViewerPose>().camera()).world_from_camera;
        times = next == pose ? times + 1 : 1;
        pose = next;
      }
      return times >= kTimes && !(pose == Rigid{});
    }));
    return pose;
  }

  std::size_t shown_ = 0;  ///< Gaussians, without those of objects that are not there
  std::string preloaded_;  ///< library, into the viewer
  std::string out_;
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber poses_;
  std::optional<Display> display_;
  std::optional<bus_test::ChildProcess> viewer_;
};

}  // namespace splatbus::stream_test
