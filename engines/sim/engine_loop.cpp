#include "sim/engine_loop.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <chrono>
#include <cmath>
#include <span>
#include <stdexcept>
#include <vector>

namespace splatbus::sim {
namespace {

constexpr std::size_t kMostRemembered = 64;
constexpr std::size_t kMostAtOnce = 8;  // cameras, between two waits for a device that others use too
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

bool is_picture(const splatbus_camera_request& request) {
  return request.camera.role != SPLATBUS_ROLE_LIGHT && request.camera.role != SPLATBUS_ROLE_PROBE;
}

/// Engines that skip frames, each by its own load, meet where the number is a multiple of as many as they take: in a
/// scene that moves, what one of them shows alone is of no use.
std::uint64_t common_frame(std::uint64_t frame, std::uint64_t next) {
  const std::uint64_t stride = std::bit_ceil(next - frame);
  return (next + stride - 1) / stride * stride;
}

void show(const std::vector<splatbus_image>& images, splatbus_frame& frame) {
  frame.images = images.data();
  frame.image_count = images.size();
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
  const std::int64_t start_ns = options_.shared_clock ? 0 : now_ns();
  const auto frame_now = [&] {
    return static_cast<std::uint64_t>(static_cast<double>(now_ns() - start_ns) * 1e-9 * options_.fps);
  };
  std::uint64_t frame = options_.shared_clock ? frame_now() : 0;
  for (std::uint64_t rendered = 0; options_.frames == 0 || rendered < options_.frames; ++rendered) {
    wait_until(start_ns + std::llround(static_cast<double>(frame) * 1e9 / options_.fps), stop);
    if (stop) return;
    render_frame(frame);
    std::uint64_t next = std::max(frame + 1, frame_now());
    if (options_.shared_clock) next = common_frame(frame, next);
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
  renderer_.set_time(time_of(frame));
  render_cameras(frame, schedule_.due(time_of(frame), depth_versions()), true);
  submit_scene(frame);
}

void EngineLoop::submit_scene(std::uint64_t frame) {
  if (submitted_scene_ == renderer_.scene_version()) return;
  const splatbus_frame scene = frame_of(frame, {}, {});
  const splatbus_status status = splatbus_engine_submit(&engine_, &scene);
  if (status != SPLATBUS_OK) spdlog::error("frame {}: {}", frame, splatbus_engine_last_error(&engine_));
  if (status == SPLATBUS_ERROR_BUS) return;  // the next frame says it
  submitted_scene_ = renderer_.scene_version();
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
  for (std::span<const splatbus_camera_request> left = requests; !left.empty();) {
    const splatbus_camera_request& request = left.front();
    if (bounded && is_picture(request) && has_picture && now_ns() > end_ns) {
      schedule_.postpone(request);
      count("cameras_postponed", static_cast<double>(++cameras_postponed_));
      left = left.subspan(1);
      continue;
    }
    const double left_ms = static_cast<double>(end_ns - now_ns()) * 1e-6;
    const auto in_time = static_cast<std::size_t>(std::max(1.0, left_ms / std::max(render_ms_, 1e-3)));
    const std::size_t rendered = render_next(frame, left.first(bounded ? std::min(in_time, left.size()) : left.size()));
    has_picture = has_picture || std::ranges::any_of(left.first(rendered), is_picture);
    left = left.subspan(rendered);
  }
  count("cameras_submitted", static_cast<double>(cameras_submitted_));
  count("cameras_rendered", static_cast<double>(cameras_rendered_));
  count("render_ms", render_ms_);
}

std::size_t EngineLoop::render_next(std::uint64_t frame, std::span<const splatbus_camera_request> requests) {
  const std::span next = requests.first(readback_ == nullptr ? 1 : std::min(kMostAtOnce, requests.size()));
  const std::int64_t begin_ns = now_ns();
  Drawn drawn;
  for (const splatbus_camera_request& request : next) {
    try {
      draw(frame, request, drawn);
    } catch (const std::exception& why) {
      if (readback_ != nullptr) readback_->keep(drawn.frames.size());
      failed(frame, request, why);
    }
  }
  if (readback_ == nullptr || drawn.frames.empty()) return next.size();
  try {
    const std::vector<std::vector<splatbus_image>>& images = readback_->finish();
    assert(images.size() == drawn.frames.size());
    count_render(begin_ns, images.size());
    for (std::size_t i = 0; i < images.size(); ++i) show(images[i], drawn.frames[i]);
  } catch (const std::exception& why) {
    for (const splatbus_camera_request& request : drawn.requests) failed(frame, request, why);
    return next.size();
  }
  submit_drawn(frame, drawn);
  return next.size();
}

void EngineLoop::submit_drawn(std::uint64_t frame, const Drawn& drawn) {
  try {
    submit(drawn.frames);
    return;
  } catch (const std::exception& why) {
    spdlog::warn("frame {}: one of {} cameras is refused: {}", frame, drawn.frames.size(), why.what());
  }
  // What is wrong with one of them is not the others'; to send one twice does no harm.
  for (std::size_t i = 0; i < drawn.frames.size(); ++i) {
    try {
      submit(std::span(drawn.frames).subspan(i, 1));
    } catch (const std::exception& why) {
      failed(frame, drawn.requests[i], why);
    }
  }
}

void EngineLoop::draw(std::uint64_t frame, const splatbus_camera_request& request, Drawn& drawn) {
  LightCamera view{request.camera, Projection::Pinhole};
  if (request.camera.role == SPLATBUS_ROLE_LIGHT) {
    const std::optional<LightCamera> light = renderer_.light_camera(request);
    if (!light) return;
    view = *light;
  }
  if (readback_ == nullptr) {
    // In host memory there is room for one camera's pictures.
    const std::vector<splatbus_image> images = images_of(pictures_for(request, view));
    splatbus_frame out = frame_of(frame, request, view);
    show(images, out);
    submit(std::span(&out, 1));
    return;
  }
  renderer_.render(view, request.buffers, *readback_);
  drawn.frames.push_back(frame_of(frame, request, view));
  drawn.requests.push_back(request);
}

void EngineLoop::failed(std::uint64_t frame, const splatbus_camera_request& request, const std::exception& why) {
  spdlog::error("frame {}: {}", frame, why.what());
  // Pictures wait for it; while its light rests it would not be due again.
  if (request.camera.role == SPLATBUS_ROLE_LIGHT) schedule_.postpone(request);
  count("cameras_failed", static_cast<double>(++cameras_failed_));
}

void EngineLoop::count_render(std::int64_t begin_ns, std::size_t cameras) {
  const double took_ms = static_cast<double>(now_ns() - begin_ns) * 1e-6 / static_cast<double>(cameras);
  render_ms_ = cameras_rendered_ == 0 ? took_ms : std::lerp(took_ms, render_ms_, std::pow(0.95, cameras));
  cameras_rendered_ += cameras;
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
  count_render(begin_ns, 1);
  const bool room = known != rendered_.end() || rendered_.size() < kMostRemembered;
  if (schedule_.repeats(key) && room && std::uint64_t{camera.width} * camera.height <= kMostRememberedPixels) {
    rendered_.insert_or_assign(key, Rendered{camera, request.buffers, renderer_.scene_version(), pictures});
  }
  return pictures;
}

splatbus_frame EngineLoop::frame_of(std::uint64_t frame, const splatbus_camera_request& request,
                                    const LightCamera& view) const {
  const Instant& instant = renderer_.instant();
  splatbus_frame out{};
  out.frame = frame;
  out.time_s = instant.time_s;
  out.request_id = request.request_id;
  out.camera = view.camera;
  out.light_id = request.light_id;
  out.light_map = request.light_map;
  out.objects = instant.objects.data();
  out.object_count = instant.objects.size();
  out.light = instant.whole_light();
  return out;
}

void EngineLoop::submit(std::span<const splatbus_frame> frames) {
  if (splatbus_engine_submit_all(&engine_, frames.data(), frames.size()) != SPLATBUS_OK) {
    throw std::runtime_error(splatbus_engine_last_error(&engine_));
  }
  cameras_submitted_ += frames.size();
  submitted_scene_ = renderer_.scene_version();
}

void EngineLoop::count(const char* name, double value) {
  if (splatbus_engine_counter(&engine_, name, value) != SPLATBUS_OK) {
    throw std::runtime_error(splatbus_engine_last_error(&engine_));
  }
}

}  // namespace splatbus::sim
