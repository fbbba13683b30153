#include "viewer/replay.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <memory>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "metrics/image_io.h"
#include "stream/follower.h"
#include "stream/packet_log.h"
#include "stream/playout.h"
#include "viewer/camera_path.h"
#include "viewer/loss_limit.h"
#include "viewer/painter.h"
#include "viewer/row_feed.h"
#include "viewer/window.h"

namespace splatbus::viewer {
namespace {

constexpr std::int64_t kStateNs = 33'333'333;  // where the log does not say how far states are apart
constexpr std::int64_t kMaxStateNs = 1'000'000'000;
constexpr std::chrono::milliseconds kIdle{5};  // until the log is looked at again

/// What a StreamReceiver hands over, from a file.
class LogFeed {
 public:
  LogFeed(const std::string& log, bool rows, bool fades, std::size_t max_gaussians)
      : reader_(log), follower_({.name = "replay", .max_gaussians = max_gaussians}, 0), begin_ns_(bus::now_ns()) {
    if (rows) feed_.emplace(follower_.replica(), fades);
    shown_.scene = std::make_shared<const SceneState>();
  }

  /// The next message; false at the end.
  bool next() {
    const auto message = reader_.next();
    if (!message) return false;
    const stream::SceneInstant before = follower_.replica().scene_instant();
    const std::uint64_t version = follower_.replica().scene_version();
    try {
      follower_.receive(message->packet, message->payload, bus::now_ns());
    } catch (const stream::StreamError& error) {
      spdlog::warn("message {}: {}", count_, error.what());
    }
    ++count_;
    const stream::Replica& replica = follower_.replica();
    new_state_ = replica.scene_instant() != before || replica.scene_version() != version;
    return true;
  }
  [[nodiscard]] bool new_state() const { return new_state_; }
  [[nodiscard]] std::int64_t capture_ns() const { return follower_.replica().scene_instant().capture_ns; }

  [[nodiscard]] float time_s() const {
    return 1 + static_cast<float>(static_cast<double>(bus::now_ns() - begin_ns_) / 1e9);
  }

  /// For a painter that has nothing yet.
  void give_all() {
    if (feed_) {
      shown_.batches = {feed_->everything()};
    } else {
      shown_.changes = follower_.replica().whole();
    }
  }
  Shown& take() {
    shown_.changes.append(follower_.replica().take_changes());
    if (feed_) {
      if (gl::SharedBatch batch = feed_->take(time_s())) shown_.batches.push_back(std::move(batch));
    }
    if (new_state_) shown_.scene = std::make_shared<const SceneState>(follower_.replica().scene());
    shown_.gaussians = follower_.replica().count();
    return shown_;
  }

 private:
  stream::PacketLogReader reader_;
  stream::Follower follower_;
  std::optional<RowFeed> feed_;
  std::int64_t begin_ns_;
  std::size_t count_ = 0;
  bool new_state_ = false;
  Shown shown_;
};

std::uint64_t replay_to_files(LogFeed& feed, Painter& painter, const Options& options, const std::stop_token& stop) {
  namespace fs = std::filesystem;
  fs::create_directories(options.out);
  const CameraPath path(options.path);
  std::uint64_t drawn = 0;
  while (!stop.stop_requested() && feed.next()) {
    Shown& shown = feed.take();
    const bool changed = painter.take(shown) || feed.new_state();
    if (!changed || shown.gaussians == 0) continue;
    if (drawn % options.frames == 0) {
      const Camera camera = path.at(options.path.start_s + static_cast<double>(drawn) / options.fps);
      metrics::write_png((fs::path(options.out) / fmt::format("frame_{:06}.png", drawn)).string(),
                         painter.draw(camera, *shown.scene));
    }
    ++drawn;
  }
  return drawn;
}

/// States come when the engine had them, from the first one on.
class Pace {
 public:
  explicit Pace(std::int64_t now_ns) : due_ns_(now_ns) {}
  void state(std::int64_t capture_ns) {
    const std::int64_t apart_ns = before_ns_ > 0 ? capture_ns - before_ns_ : kStateNs;
    due_ns_ += apart_ns > 0 ? std::min(apart_ns, kMaxStateNs) : kStateNs;
    before_ns_ = capture_ns;
  }
  [[nodiscard]] bool due(std::int64_t now_ns) const { return now_ns >= due_ns_; }

 private:
  std::int64_t due_ns_, before_ns_ = 0;
};

class WindowReplay {
 public:
  WindowReplay(LogFeed& feed, Window& window, std::function<std::unique_ptr<Painter>()> make_painter)
      : feed_(feed), window_(window), make_painter_(std::move(make_painter)), painter_(make_painter_()) {}

  /// Until the window is closed; how many pictures it has drawn.
  std::uint64_t run(const std::stop_token& stop) {
    LossLimit losses;
    while (!stop.stop_requested() && !window_.closed()) {
      try {
        turn();
      } catch (const ContextLost& lost) {
        spdlog::warn("{}", lost.what());
        losses.recover(lost, [&] {
          painter_.reset();
          window_.reopen();
          painter_ = make_painter_();
        });
        spdlog::info("there is another context, and all is drawn anew");
        feed_.give_all();
      }
    }
    return drawn_;
  }

 private:
  void turn() {
    window_.poll_events();
    bool changed = false;
    while (more_ && pace_.due(bus::now_ns())) {
      more_ = feed_.next();
      const bool new_state = more_ && feed_.new_state();
      Shown& shown = feed_.take();
      changed = painter_->take(shown) || new_state || changed;
      if (!new_state) continue;
      pace_.state(feed_.capture_ns());
      playout_.add(shown.scene, feed_.capture_ns(), bus::now_ns());
    }
    Shown& shown = feed_.take();  // what has faded
    changed = painter_->take(shown) || changed;
    changed = window_.take_picture_due() || changed;
    window_.set_figures({.held = shown.gaussians, .drawn = {}, .stream = {}});
    if (window_.take_frame_all()) {
      if (const auto bounds = painter_->bounds()) window_.frame(bounds->centre, bounds->radius_m);
    }
    const bool moving = playout_.moving();
    playout_.advance(bus::now_ns());
    const auto scene = playout_.scene();
    window_.follow(scene ? *scene : *shown.scene);
    const Camera camera = window_.camera();
    const float time_s = feed_.time_s();
    const bool settles = painter_->settles(time_s);
    changed = changed || moving || unsettled_ || settles || !(camera == before_);
    if (!changed) {
      window_.wait_events(kIdle);
      return;
    }
    before_ = camera;
    unsettled_ = settles;  // the last one is drawn once all has settled
    painter_->show(window_, camera, window_.settings().applied_to(scene ? *scene : *shown.scene), time_s);
    ++drawn_;
  }

  LogFeed& feed_;
  Window& window_;
  std::function<std::unique_ptr<Painter>()> make_painter_;
  std::unique_ptr<Painter> painter_;
  stream::Playout playout_;
  Pace pace_{bus::now_ns()};
  std::uint64_t drawn_ = 0;
  bool more_ = true, unsettled_ = false;
  Camera before_;
};

}  // namespace

std::uint64_t replay(const std::string& log, const Options& options, Device device, const std::stop_token& stop) {
  if (!options.window && (options.out.empty() || options.frames == 0)) {
    throw bus::Error(
        "a replay needs a window (--window), or a folder and which pictures: --set out=FOLDER --set frames=1");
  }
  std::unique_ptr<Window> window;
  if (options.window) {
    window = std::make_unique<Window>(CameraPath(options.path).at(options.path.start_s), "splatbus: " + log,
                                      options.draws_through_opengl() ? Window::For::Splats : Window::For::Pictures);
    window->save_in(options.out);
  }
  const bool opengl = options.draws_through_opengl() && (!window || window->takes_splats());
  const auto make_painter = [&] {
    return opengl ? make_gl_painter(options.window, options.draw) : make_raster_painter(device, options.threads);
  };
  LogFeed feed(log, opengl, options.window, options.max_gaussians);
  std::uint64_t drawn = 0;
  if (window) {
    drawn = WindowReplay(feed, *window, make_painter).run(stop);
  } else {
    drawn = replay_to_files(feed, *make_painter(), options, stop);
  }
  spdlog::info("{}: {} pictures", log, drawn);
  return drawn;
}

}  // namespace splatbus::viewer
