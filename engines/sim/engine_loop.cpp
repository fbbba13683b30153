#include "sim/engine_loop.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <stdexcept>
#include <vector>

namespace splatbus::sim {
namespace {

constexpr std::size_t kMostRemembered = 64;
constexpr std::uint64_t kMostRememberedPixels = std::uint64_t{384} * 384;

bool same_view(const splatbus_camera& a, const splatbus_camera& b) {
  const auto values = [](const splatbus_camera& c) {
    const float* q = c.world_from_camera.rotation_wxyz;
    const float* t = c.world_from_camera.translation;
    return std::array{c.fx, c.fy, c.cx, c.cy, c.near_m, c.far_m, q[0], q[1], q[2], q[3], t[0], t[1], t[2]};
  };
  return a.width == b.width && a.height == b.height && values(a) == values(b);
}

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

template <class T>
void add_image(std::vector<splatbus_image>& images, splatbus_buffer buffer, const std::vector<T>& pixels) {
  if (pixels.empty()) return;
  images.push_back(
      {static_cast<std::uint32_t>(buffer), pixels.data(), pixels.size() * sizeof(T), SPLATBUS_MEMORY_HOST});
}

std::vector<splatbus_image> images_of(const Pictures& pictures) {
  std::vector<splatbus_image> images;
  add_image(images, SPLATBUS_BUFFER_COLOR, pictures.color);
  add_image(images, SPLATBUS_BUFFER_WORLD_POSITION, pictures.world_position);
  add_image(images, SPLATBUS_BUFFER_NORMAL, pictures.normal);
  add_image(images, SPLATBUS_BUFFER_OBJECT_ID, pictures.object_id);
  add_image(images, SPLATBUS_BUFFER_ALBEDO, pictures.albedo);
  add_image(images, SPLATBUS_BUFFER_DEPTH, pictures.depth);
  add_image(images, SPLATBUS_BUFFER_LIGHT_DEPTH, pictures.light_depth);
  return images;
}

}  // namespace

EngineHandle open_engine(const std::string& address, const std::string& name, splatbus_memory memory) {
  splatbus_engine* engine = nullptr;
  if (splatbus_engine_open(address.empty() ? nullptr : address.c_str(), name.c_str(), SPLATBUS_ENGINE_ABI, memory,
                           &engine) != SPLATBUS_OK) {
    throw std::runtime_error(splatbus_engine_last_error(nullptr));
  }
  return EngineHandle(engine);
}

EngineLoop::EngineLoop(splatbus_engine& engine, Renderer& renderer, DeviceReadback* readback,
                       const EngineLoopOptions& options)
    : engine_(engine), renderer_(renderer), readback_(readback), options_(options) {}

void EngineLoop::run(const std::atomic<bool>& stop) {
  const std::int64_t start_ns = now_ns();
  std::uint64_t frame = 0;
  for (std::uint64_t rendered = 0; options_.frames == 0 || rendered < options_.frames; ++rendered) {
    wait_until(start_ns + std::llround(static_cast<double>(frame) * 1e9 / options_.fps), stop);
    if (stop) return;
    render_frame(frame);
    const auto current = static_cast<std::uint64_t>(static_cast<double>(now_ns() - start_ns) * 1e-9 * options_.fps);
    const std::uint64_t next = std::max(frame + 1, current);
    frames_skipped_ += next - frame - 1;
    frame = next;
    count("frame", static_cast<double>(frame));
    count("frames_skipped", static_cast<double>(frames_skipped_));
  }
}

void EngineLoop::wait_until(std::int64_t deadline_ns, const std::atomic<bool>& stop) {
  bool polled = false;
  while (!stop) {
    const std::int64_t left_ns = deadline_ns - now_ns();
    if (left_ns <= 0 && polled) return;
    polled = true;  // requests are taken in at least once a frame
    const splatbus_camera_request* requests = nullptr;
    std::size_t size = 0;
    int changed = 0;
    const int timeout_ms = static_cast<int>(std::max<std::int64_t>(0, (left_ns + 999'999) / 1'000'000));
    if (splatbus_engine_poll(&engine_, timeout_ms, &requests, &size, &changed) != SPLATBUS_OK) {
      throw std::runtime_error(splatbus_engine_last_error(&engine_));
    }
    if (changed != 0) {
      schedule_.replace({requests, size});
      std::erase_if(rendered_, [&](const auto& entry) { return !schedule_.repeats(entry.first); });
      count("cameras", static_cast<double>(schedule_.size()));
      render_newcomers();
    }
  }
}

void EngineLoop::render_frame(std::uint64_t frame) {
  options_.before_frame();
  standing_frame_ = frame;
  // Whether light depth is due depends on what has moved by now.
  if (schedule_.watches_scene()) renderer_.set_time(time_of(frame));
  render_cameras(frame, schedule_.due(time_of(frame), depth_versions()), true);
}

Schedule::DepthVersion EngineLoop::depth_versions() const {
  return [this](const splatbus_camera_request& request) { return renderer_.depth_version(request); };
}

void EngineLoop::render_newcomers() {
  if (!standing_frame_) return;
  const double time_s = time_of(*standing_frame_);
  if (schedule_.watches_scene()) renderer_.set_time(time_s);
  render_cameras(*standing_frame_, schedule_.newcomers(time_s, depth_versions()), false);
}

void EngineLoop::render_cameras(std::uint64_t frame, const std::vector<splatbus_camera_request>& requests,
                                bool bounded) {
  if (requests.empty()) return;
  renderer_.set_time(time_of(frame));
  const std::int64_t end_ns = now_ns() + std::llround(options_.pictures_s * 1e9);
  bool has_picture = false;
  for (const splatbus_camera_request& request : requests) {
    const bool is_picture = request.camera.role != SPLATBUS_ROLE_LIGHT && request.camera.role != SPLATBUS_ROLE_PROBE;
    if (bounded && is_picture && has_picture && now_ns() > end_ns) {
      schedule_.postpone(request);
      count("cameras_postponed", static_cast<double>(++cameras_postponed_));
      continue;
    }
    has_picture = has_picture || is_picture;
    try {
      render_camera(frame, request);
    } catch (const std::exception& failed) {
      spdlog::error("frame {}: {}", frame, failed.what());
      // Pictures wait for it; while its light rests it would not be due again.
      if (request.camera.role == SPLATBUS_ROLE_LIGHT) schedule_.postpone(request);
      count("cameras_failed", static_cast<double>(++cameras_failed_));
    }
  }
  count("cameras_submitted", static_cast<double>(cameras_submitted_));
  count("cameras_rendered", static_cast<double>(cameras_rendered_));
  count("render_ms", render_ms_);
}

std::vector<splatbus_image> EngineLoop::images_for(const splatbus_camera_request& request, const LightCamera& camera) {
  if (readback_ == nullptr) return images_of(pictures_for(request, camera));
  const std::int64_t begin_ns = now_ns();
  renderer_.render(camera, request.buffers, *readback_);
  std::vector<splatbus_image> images = readback_->images();
  count_render(begin_ns);
  return images;
}

void EngineLoop::count_render(std::int64_t begin_ns) {
  ++cameras_rendered_;
  const double took_ms = static_cast<double>(now_ns() - begin_ns) * 1e-6;
  render_ms_ = cameras_rendered_ == 1 ? took_ms : 0.95 * render_ms_ + 0.05 * took_ms;
}

const Pictures& EngineLoop::pictures_for(const splatbus_camera_request& request, const LightCamera& view) {
  const splatbus_camera& camera = view.camera;
  const std::pair key{camera.role, camera.id};
  const auto known = rendered_.find(key);
  if (known != rendered_.end() && known->second.scene_version == renderer_.scene_version() &&
      known->second.buffers == request.buffers && same_view(known->second.camera, camera)) {
    return known->second.pictures;
  }
  const std::int64_t begin_ns = now_ns();
  const Pictures& pictures = renderer_.render(view, request.buffers);
  count_render(begin_ns);
  const bool room = known != rendered_.end() || rendered_.size() < kMostRemembered;
  if (schedule_.repeats(key) && room && std::uint64_t{camera.width} * camera.height <= kMostRememberedPixels) {
    rendered_.insert_or_assign(key, Rendered{camera, request.buffers, renderer_.scene_version(), pictures});
  }
  return pictures;
}

void EngineLoop::render_camera(std::uint64_t frame, const splatbus_camera_request& request) {
  LightCamera view{request.camera, Projection::Pinhole};
  if (request.camera.role == SPLATBUS_ROLE_LIGHT) {
    const std::optional<LightCamera> light = renderer_.light_camera(request);
    if (!light) return;
    view = *light;
  }
  const std::vector<splatbus_image> images = images_for(request, view);
  const Instant& instant = renderer_.instant();
  splatbus_frame out{};
  out.frame = frame;
  out.time_s = instant.time_s;
  out.request_id = request.request_id;
  out.camera = view.camera;
  out.light_id = request.light_id;
  out.light_map = request.light_map;
  out.images = images.data();
  out.image_count = images.size();
  out.objects = instant.objects.data();
  out.object_count = instant.objects.size();
  out.light = instant.whole_light();
  if (splatbus_engine_submit(&engine_, &out) != SPLATBUS_OK) {
    throw std::runtime_error(splatbus_engine_last_error(&engine_));
  }
  ++cameras_submitted_;
}

void EngineLoop::count(const char* name, double value) {
  if (splatbus_engine_counter(&engine_, name, value) != SPLATBUS_OK) {
    throw std::runtime_error(splatbus_engine_last_error(&engine_));
  }
}

}  // namespace splatbus::sim
