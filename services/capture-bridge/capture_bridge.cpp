#include "capture-bridge/capture_bridge.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <exception>
#include <utility>

#include "bus/clock.h"
#include "bus/frames.h"
#include "bus/log_sink.h"
#include "bus/memory.h"
#include "capture-bridge/nanoseconds.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kProbePatienceNs = 2 * kSecond;  // then the engine is asked again
constexpr std::int64_t kLightMapPatienceNs = kSecond;
constexpr std::size_t kMaxProbes = 64;
// By ids and depth those who judge pictures tell what moves, and what lies in shadow.
const wire::EngineBuffer kProbeBuffers =
    wire::EngineBuffer::Color | wire::EngineBuffer::ObjectId | wire::EngineBuffer::Depth;
constexpr int kMaxMessagesAStep = 256;

}  // namespace

CaptureBridge::CaptureBridge(std::shared_ptr<bus::Context> context, const bus::Parameters& parameters, Device backend)
    : context_(std::move(context)),
      options_(parameters),
      subscriber_(context_),
      publisher_(context_),
      forwarder_(context_, backend),
      // A bridge in another's place, or started again, must not repeat that one's ids: the engine has answered those.
      rigs_(parameters, static_cast<std::uint64_t>(bus::now_ns())),
      probes_(kMaxProbes),
      input_pictures_(backend),
      blindness_(backend),
      sharing_(context_, backend, options_->round_sizes()),
      worker_(context_, backend, options_->round_sizes()) {
  const RoundSizes expected = options_->round_sizes();
  subscribe();
  input_pictures_.reserve(expected.views, input_view_bytes(expected.pixels));
}

void CaptureBridge::step(std::chrono::milliseconds timeout) {
  options_.refresh();
  update_rigs(bus::now_ns());
  publish_cameras();
  subscriber_.dispatch_all(timeout, kMaxMessagesAStep);
  const std::int64_t now = bus::now_ns();
  use_waiting_frames(now);
  const std::uint64_t refused = subscriber_.refused() + waiting_refused_;
  const bool refused_one = std::exchange(counters_.refused, refused) != refused;
  if (worker_.take_failure() || refused_one) bus::require_usable(input_pictures_.kind());
  engines_.update(now);
  update_rounds(now);
  share_rounds(now);
  update_light_maps(now);
  refresh_pictures(now);
  update_probes(now);
  publish_cameras();
}

void CaptureBridge::subscribe() {
  subscribe_to_helpers();
  subscriber_
      .on(topics::kEngineFrame,
          [this](const wire::EngineFrame& frame, const bus::Message& message) { handle_frame(frame, message); })
      .on(topics::kViewerPose, [this](const wire::ViewerPose& pose, const bus::Message&) { handle_pose(pose); })
      .on(topics::kViewerProbe,
          [this](const wire::ViewerProbe& asked, const bus::Message& message) { handle_probe(asked, message); })
      .on(topics::kTrainerStats,
          [this](const wire::TrainerStats& stats, const bus::Message& message) {
            handle_trainer_stats(stats, message, trainer_watches_);
          })
      .on(topics::kTrainerStandby,
          [this](const wire::TrainerStats& stats, const bus::Message& message) {
            handle_trainer_stats(stats, message, standby_watches_);
          })
      .on(topics::kGridState,
          [this](const wire::GridState& state, const bus::Message& message) { handle_grid_state(state, message); });
}

void CaptureBridge::handle_pose(const wire::ViewerPose& pose) {
  if (viewers_.take(pose, bus::now_ns())) return;
  ++counters_.poses_dropped;
}

void CaptureBridge::handle_probe(const wire::ViewerProbe& asked, const bus::Message& message) {
  const Camera camera = from_wire(*asked.camera());
  std::optional<Probe> evicted;
  Probe* probe = probes_.add(asked.probe_id(), message.header().source()->str(), camera, bus::now_ns(), evicted);
  if (evicted) {
    rigs_.cameras().remove(CameraRole::Probe, evicted->camera.id);
    ++counters_.probes_dropped;
    static bus::LogLimiter limiter;
    if (limiter.allow()) {
      spdlog::warn("probe {} of {} dropped: {} wait already", evicted->probe_id, bus::printable(evicted->asker),
                   kMaxProbes);
    }
  }
  if (probe != nullptr) ProbeTable::ask(*probe, rigs_.cameras().add(probe->camera, kProbeBuffers, 0), bus::now_ns());
}

void CaptureBridge::handle_trainer_stats(const wire::TrainerStats& stats, const bus::Message& message,
                                         TrainerWatches& watches) {
  const auto lacks = [&](TrainerWatch& watch, std::uint32_t held, const Published& published, const char* what) {
    const std::size_t all = published.camera_ids.size();
    if (!watch.lacks_views(message.header().epoch(), held, all, published.last_ns, bus::now_ns())) return false;
    static bus::LogLimiter limiter;
    if (limiter.allow()) {
      spdlog::info("{} holds {} of {} {} views: asking the engine for all again",
                   bus::printable(message.header().source()->string_view()), held, all, what);
    }
    return true;
  };
  if (lacks(watches.inputs, stats.ready_inputs(), inputs_published_, "input")) {
    rigs_.inputs().reissue_all(rigs_.cameras());
  }
  if (lacks(watches.references, stats.ready_references(), references_published_, "reference")) {
    rigs_.cameras().reissue_all(CameraRole::Reference);
  }
}

void CaptureBridge::update_rigs(std::int64_t now_ns) {
  viewers_.expire(now_ns);
  const auto left = rigs_.update(viewers_, now_ns);
  rigs_.update_lights(forwarder_.light());
  for (const Camera& camera : left) {
    const bool reference = camera.role == CameraRole::Reference;
    (reference ? references_published_ : inputs_published_).camera_ids.erase(camera.id);
    (reference ? refreshed_references_ : refreshed_inputs_).pictures.forget(camera.id);
    forwarder_.retire(camera);
  }
  for (const std::uint32_t camera_id : rigs_.inputs().take_placed()) refreshed_inputs_.pictures.forget(camera_id);
}

/// A light that rests has its maps rendered once: one that was lost on its way would never come.
void CaptureBridge::update_light_maps(std::int64_t now_ns) {
  if (now_ns < next_light_maps_ns_) return;
  next_light_maps_ns_ = now_ns + kLightMapPatienceNs;
  rigs_.reissue_missing_lights();
}

void CaptureBridge::refresh_pictures(std::int64_t now_ns) {
  // What shows new ground comes first: an engine that renders slowly would do nothing but render old places again. A
  // picture that never comes keeps the others from it for a while only.
  const bool waits = rigs_.inputs().wait_for_pictures(nanoseconds(options_->input_deadline_s));
  if (options_->input_rate_hz <= 0 && !waits) {
    refresh(refreshed_inputs_, CameraRole::Input, options_->input_refresh_hz, now_ns);
  }
  if (options_->reference_rate_hz <= 0) {
    refresh(refreshed_references_, CameraRole::Reference, options_->reference_refresh_hz, now_ns);
  }
}

void CaptureBridge::refresh(Refresh& of, CameraRole role, double rate_hz, std::int64_t now_ns) {
  if (rate_hz <= 0 || now_ns < of.next_ns) return;
  of.next_ns = now_ns + nanoseconds(1 / rate_hz);
  if (const auto stalest = of.pictures.take(forwarder_.newest_version(), now_ns)) rigs_.reissue(role, *stalest);
}

void CaptureBridge::update_probes(std::int64_t now_ns) {
  for (const Probe& probe : probes_.expire(now_ns - nanoseconds(options_->probe_timeout_s))) {
    rigs_.cameras().remove(CameraRole::Probe, probe.camera.id);
    ++counters_.probes_dropped;
    static bus::LogLimiter limiter;
    if (limiter.allow()) {
      spdlog::warn("probe {} of {} dropped: the engine did not answer", probe.probe_id, bus::printable(probe.asker));
    }
  }
  for (Probe* probe : probes_.overdue(now_ns - kProbePatienceNs)) {
    ProbeTable::ask(*probe, rigs_.cameras().add(probe->camera, kProbeBuffers, 0), now_ns);
  }
}

void CaptureBridge::publish_cameras() {
  const bool changed = rigs_.cameras().take_changed();
  const bool divided_anew = engines_.take_changed();
  if (!changed && !divided_anew) return;
  const std::vector<CameraRequest>& all = rigs_.cameras().requests();
  if (!engines_.shared()) return publish_cameras(all, "");
  // Whoever has none by name yet waits.
  if (!std::exchange(divided_, true)) publish_cameras({}, "");
  for (const auto& [engine, requests] : engines_.divide(all, bus::now_ns())) publish_cameras(requests, engine);
}

void CaptureBridge::publish_cameras(std::span<const CameraRequest> cameras, const std::string& engine) {
  const bus::MessageInfo info{.latch_key = engine};
  publisher_.publish(topics::kEngineCameras, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::CameraRequest>> requests;
    requests.reserve(cameras.size());
    for (const CameraRequest& request : cameras) {
      const wire::Camera camera = to_wire(request.camera);
      requests.push_back(wire::CreateCameraRequest(builder, &camera, request.buffers, request.rate_hz,
                                                   request.request_id, request.light_id,
                                                   static_cast<std::uint8_t>(request.light_map), request.extent_m));
    }
    return wire::CreateEngineCameras(builder, header, builder.CreateVector(requests));
  });
}

}  // namespace splatbus::capture_bridge
