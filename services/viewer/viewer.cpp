#include "viewer/viewer.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <filesystem>
#include <random>
#include <thread>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/trace.h"
#include "metrics/image_io.h"

namespace splatbus::viewer {

namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSecondNs = 1'000'000'000;
constexpr std::int64_t kLongestWaitNs = 50'000'000;
constexpr std::int64_t kProbePatienceNs = 150'000'000;  // for visibility, which comes some 20 times a second
constexpr std::int64_t kProbeLookNs = 5'000'000;        // until it is looked whether it is there
constexpr std::int64_t kIdleWindowNs = 5'000'000;       // until mouse and keys are looked at again

ClientOptions client_options(const Options& options, const ViewerHost& host) {
  return {.endpoint = host.endpoint,
          .find_endpoint = host.find_endpoint,
          .name = host.name,
          .key = options.key,
          .server_key = options.server_key,
          .token = options.token,
          .ca = options.ca,
          .probes = options.probe,
          .max_gaussians = options.max_gaussians,
          .max_kbps = static_cast<std::uint32_t>(options.max_kbps),
          .packet_log = options.packet_log};
}

// Viewers choose their ids without asking each other.
std::uint64_t first_probe_id() {
  return std::uint64_t{std::random_device{}()} << 20 | 1;
}

std::unique_ptr<Window> make_window(const Options& options, const Camera& camera, const std::string& name) {
  if (!options.window) return nullptr;
  const auto what = options.draws_through_opengl() ? Window::For::Splats : Window::For::Pictures;
  return std::make_unique<Window>(camera, "splatbus: " + name, what);
}

ViewerHost of_the_same_path(ViewerHost host, const PathOptions& path) {
  if (host.place && host.place->path != name_of(path)) host.place.reset();
  return host;
}

/// A person goes on from where the window before was, with the size that this one has.
Camera first_camera(const Options& options, const CameraPath& path, const std::optional<Place>& place) {
  Camera camera = path.at(place ? place->path_s : options.path.start_s);
  if (place && options.window) camera.world_from_camera = place->camera.world_from_camera;
  return camera;
}

std::unique_ptr<Painter> make_painter(const Options& options, bool opengl, Device device) {
  if (opengl) return make_gl_painter(options.window, options.draw);
  return make_raster_painter(device, options.threads);
}

}  // namespace

Viewer::Viewer(const bus::Parameters& parameters, ViewerHost host)
    : options_(parameters),
      host_(of_the_same_path(std::move(host), options_->path)),
      path_(options_->path),
      path_clock_(options_->path, bus::now_ns(), host_.place ? host_.place->path_s : options_->path.start_s),
      path_options_(options_->path),
      camera_(first_camera(*options_, path_, host_.place)),
      window_(make_window(*options_, camera_, host_.name)),
      opengl_(options_->draws_through_opengl() && (!window_ || window_->takes_splats())),
      painter_(make_painter(*options_, opengl_, host_.device)),
      receiver_(client_options(*options_, host_),
                opengl_ ? StreamReceiver::Gives::Rows : StreamReceiver::Gives::Changes),
      begin_ns_(bus::now_ns()),
      next_probe_id_(first_probe_id()) {
  if (window_) {
    window_stream_.emplace(*window_, receiver_, options_->out, options_->max_gaussians,
                           static_cast<std::uint32_t>(options_->max_kbps));
  }
  if (!options_->record_file.empty()) recorder_.emplace(options_->record_file);
}

void Viewer::run() {
  bool changed = true, drawn = false;
  while (!host_.stop.stop_requested() && !(window_ && window_->closed())) {
    try {
      refresh_options();
      const auto period_ns = static_cast<std::int64_t>(1e9 / options_->fps);
      // Until the next picture is due; with none to draw, until the camera may have moved. Packets are taken at once.
      const std::int64_t left_ns = draws_at_display_rate() ? 0 : drawn_ns_ + period_ns - bus::now_ns();
      const std::int64_t idle_ns = draws_at_display_rate() ? kIdleWindowNs : period_ns;
      const std::int64_t wait_ns = std::min(left_ns > 0 ? left_ns : changed || drawn ? 0 : idle_ns, kLongestWaitNs);
      receiver_.wait_for(std::chrono::nanoseconds(probe_ ? std::min(wait_ns, kProbeLookNs) : wait_ns), !probe_);
      changed = take() || changed;
      changed = serve_window() || changed;
      const std::int64_t now_ns = bus::now_ns();
      const bool first = first_picture_ns_ == 0 && shown_.gaussians > 0;
      if (draws_at_display_rate() || now_ns >= drawn_ns_ + period_ns || first) {
        drawn = show(changed);
        if (drawn) drawn_ns_ = now_ns;
        drawn = drawn && draws_at_display_rate();  // the camera may be on its way
        changed = false;
      }
      ask_probe(now_ns);
      answer_probes();
      if (now_ns - last_report_ns_ > kSecondNs) {
        last_report_ns_ = now_ns;
        report();
      }
    } catch (const ContextLost& lost) {
      renew_context(lost);
      changed = true;
    }
  }
}

Place Viewer::place() const {
  return {.path = name_of(options_->path), .path_s = path_clock_.seconds(bus::now_ns()), .camera = camera_};
}

void Viewer::renew_context(const ContextLost& lost) {
  spdlog::warn("{}", lost.what());
  losses_.recover(lost, [&] {
    if (opengl_) painter_.reset();
    if (window_) window_->reopen();
    if (opengl_) painter_ = make_painter(*options_, opengl_, host_.device);
  });
  spdlog::info("there is another context, and all is drawn anew");
  if (!opengl_) return;
  receiver_.give_all();
  awaits_all_ = true;
}

bool Viewer::serve_window() {
  if (!window_) return false;
  window_->poll_events();
  window_stream_->turn(bus::now_ns(), *painter_, shown_.gaussians, scene_arrived_ns_);
  return window_->take_picture_due();
}

void Viewer::refresh_options() {
  if (!options_.refresh() || options_->path == path_options_) return;
  path_options_ = options_->path;
  try {
    path_ = CameraPath(path_options_);
    path_clock_.change(path_options_, bus::now_ns());
  } catch (const bus::Error& error) {
    spdlog::error("the camera keeps its path: {}", error.what());
  }
}

bool Viewer::take() {
  const bool changed = receiver_.take(shown_);
  for (TimedScene& state : shown_.scenes) {
    ages_.came(*state.scene, state.capture_ns);
    scene_arrived_ns_ = state.arrived_ns;
    playout_.add(std::move(state.scene), state.capture_ns, state.arrived_ns);
  }
  shown_.scenes.clear();
  const bool other = painter_->take(shown_);
  awaits_all_ = awaits_all_ && !other;
  return other || changed;
}

cv::Mat Viewer::draw(const Camera& camera, const SceneState& scene) {
  const std::int64_t begin_ns = bus::now_ns();
  cv::Mat picture = painter_->draw(camera, scene);
  draw_ms_ = static_cast<double>(bus::now_ns() - begin_ns) / 1e6;
  return picture;
}

bool Viewer::show(bool changed) {
  const std::int64_t now_ns = bus::now_ns();
  const Camera before = camera_;
  const bool moving = playout_.moving();
  playout_.advance(now_ns);
  painter_->advance(playout_.shown_ns());
  const std::shared_ptr<const SceneState> played = playout_.scene();
  const SceneState& scene = played ? *played : *shown_.scene;
  if (window_) window_->follow(scene);
  camera_ = window_ ? window_->camera() : path_.at(path_clock_.seconds(now_ns));
  if (recorder_) {
    recorder_->add(
        {.time_s = static_cast<double>(now_ns - begin_ns_) / 1e9, .world_from_camera = camera_.world_from_camera});
  }
  receiver_.send_pose(camera_);
  // A world that became empty is drawn as one.
  if ((shown_.gaussians == 0 && frames_ == 0) || awaits_all_) return false;
  if (window_ && window_->take_frame_all()) frame_all();
  const float time_s = receiver_.fade_time_s(now_ns);
  const bool settles = window_ ? painter_->settles(time_s) : painter_->recoloring();
  changed = changed || moving || unsettled_ || settles;
  if (!changed && frames_ > 0 && before == camera_) return false;
  const bus::TracedWork work("draw", playout_.shown_ns());
  const std::string& out = options_->out;
  const std::uint64_t every = options_->frames;
  const bool writes = !out.empty() && every > 0 && frames_ % every == 0;
  cv::Mat picture;
  if (writes || !window_) picture = draw(camera_, scene);
  if (window_) {
    const std::int64_t begin_ns = bus::now_ns();
    painter_->show(*window_, camera_, window_->settings().applied_to(scene), time_s);
    draw_ms_ = static_cast<double>(bus::now_ns() - begin_ns) / 1e6;
  }
  ages_.drawn(scene,
              {.shown_ns = moving ? playout_.shown_ns() : 0,  // a picture of a scene at rest is as old as the scene
               .finished_ns = bus::now_ns(),
               .visibility_version = painter_->drawn_visibility().value_or(shown_.visibility_version)});
  if (first_picture_ns_ == 0) {
    first_picture_ns_ = bus::now_ns();
    spdlog::info("first picture, {} Gaussians", shown_.gaussians);
  }
  unsettled_ = settles;
  if (writes) write_picture(fmt::format("frame_{:06}.png", frames_), picture);
  ++frames_;
  return true;
}

void Viewer::frame_all() {
  if (const std::optional<gl::Bounds> bounds = painter_->bounds()) window_->frame(bounds->centre, bounds->radius_m);
}

void Viewer::write_picture(const std::string& name, const cv::Mat& picture) {
  const fs::path file = fs::path(options_->out) / name;
  try {
    fs::create_directories(file.parent_path());
    metrics::write_png(file, picture);
  } catch (const std::exception& error) {
    ++unwritten_;
    if (log_limiter_.allow()) spdlog::error("{} pictures could not be written: {}", unwritten_, error.what());
  }
}

void Viewer::ask_probe(std::int64_t now_ns) {
  const double period_s = options_->probe_period_s;
  if (!options_->probe || period_s <= 0 || first_picture_ns_ == 0 || now_ns < next_probe_ns_) return;
  next_probe_ns_ = now_ns + static_cast<std::int64_t>(period_s * 1e9);
  receiver_.send_probe(next_probe_id_++, camera_);
}

bool Viewer::sees_as_probe(const ProbeAnswer& probe) const {
  if (probe.capture_ns == 0 || bus::now_ns() - probe.arrived_ns > kProbePatienceNs) return true;
  // Nothing has changed since: there is none to come.
  if (shown_.visibility_version >= shown_.scene->version) return true;
  return ages_.captured_ns(shown_.visibility_version) >= probe.capture_ns;
}

void Viewer::answer_probes() {
  if (awaits_all_) return;
  // One a turn: packets are taken in between. Without a model there is nothing to compare.
  if (!probe_) probe_ = receiver_.take_probe_answer();
  if (!probe_ || (shown_.gaussians > 0 && !sees_as_probe(*probe_))) return;
  const std::optional<ProbeAnswer> probe = std::exchange(probe_, std::nullopt);
  if (shown_.gaussians == 0) return;
  const cv::Mat picture = draw(probe->camera, probe->scene);
  const cv::Mat reference = metrics::from_rgba(probe->rgba.data(), probe->camera.width, probe->camera.height);
  last_quality_ = metrics::compare(picture, reference);
  ++compared_;
  if (!options_->out.empty()) {
    write_picture(fmt::format("probe_{}_viewer.png", probe->probe_id), picture);
    if (options_->probe_alpha) {
      write_picture(fmt::format("probe_{}_alpha.png", probe->probe_id), painter_->alpha(probe->camera, probe->scene));
    }
  }
  receiver_.send_quality(probe->probe_id, last_quality_, first_picture_ns_);
}

void Viewer::report() {
  const ReceiverStatus status = receiver_.status();
  host_.counter("gaussians", static_cast<double>(shown_.gaussians));
  host_.counter("frames", static_cast<double>(frames_));
  host_.counter("unwritten_pictures", static_cast<double>(unwritten_));
  host_.counter("draw_ms", draw_ms_);
  host_.counter("received_bytes", static_cast<double>(status.received_bytes));
  host_.counter("lost_packets", static_cast<double>(status.lost));
  host_.counter("lacked_pages", static_cast<double>(status.lacked));
  host_.counter("missing_pages", static_cast<double>(status.missing_pages));
  host_.counter("refused", static_cast<double>(status.refused));
  if (status.scene_delays > 0) {
    host_.counter("scene_delay_ms_p50", status.scene_delay_ms_p50);
    host_.counter("scene_delay_ms_p99", status.scene_delay_ms_p99);
  }
  if (ages_.ages().count() > 0) {
    host_.counter("picture_age_ms_p50", ages_.ages().quantile(0.5));
    host_.counter("picture_age_ms_p99", ages_.ages().quantile(0.99));
  }
  if (ages_.object_changes().count() > 0) {
    host_.counter("object_change_ms_p50", ages_.object_changes().quantile(0.5));
    host_.counter("object_change_ms_max", ages_.object_changes().quantile(1));
  }
  if (ages_.visibility_leads().count() > 0) {
    host_.counter("visibility_lead_ms_p50", ages_.visibility_leads().quantile(0.5));
    host_.counter("visibility_lead_ms_p95", ages_.visibility_leads().quantile(0.95));
  }
  if (compared_ > 0) {
    host_.counter("psnr_db", last_quality_.psnr_db);
    host_.counter("ssim", last_quality_.ssim);
    host_.counter("flip", last_quality_.flip);
  }
  host_.detail(!status.connected       ? fmt::format("waits for the streamer at {}", host_.endpoint)
               : shown_.gaussians == 0 ? "waits for Gaussians"
               : status.missing_pages > 0
                   ? fmt::format("shows {} of {} pages", status.pages - status.missing_pages, status.pages)
                   : "shows the stream");
}

}  // namespace splatbus::viewer
