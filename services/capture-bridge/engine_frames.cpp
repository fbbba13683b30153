#include <fmt/format.h>

#include <utility>

#include "bus/clock.h"
#include "capture-bridge/capture_bridge.h"
#include "wire/convert.h"

// What becomes of the engines' frames.
namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kMostWaiting = 32;
constexpr std::int64_t kWaitNs = 500'000'000;  // for a version: its pixels stay for about a second

bool has_picture(const wire::EngineFrame& frame) {
  const auto* tensors = frame.header()->tensors();
  return tensors != nullptr && tensors->size() > 0;
}

}  // namespace

void CaptureBridge::handle_frame(const wire::EngineFrame& frame, const bus::Message& message) {
  ++counters_.frames;
  const std::string source = frame.header()->source()->str();
  if (!engines_.leads(source)) return follow_frame(frame, message);
  if (!forwarder_.scene(frame, options_->far_field)) {
    ++counters_.frames_lost;
    return;
  }
  if (has_picture(frame)) engines_.brought(source, bus::now_ns());
  use_frame(frame, message);
}

void CaptureBridge::follow_frame(const wire::EngineFrame& frame, const bus::Message& message) {
  SceneState shows = from_wire(*frame.scene());
  if (options_->far_field) shows.objects.insert_or_assign(kFarFieldFrame, far_field());
  if (forwarder_.follow(shows)) {
    if (has_picture(frame)) engines_.brought(frame.header()->source()->str(), bus::now_ns());
    ++counters_.frames_followed;
    use_frame(frame, message);
    return;
  }
  if (!has_picture(frame)) return;
  // It may be ahead of the engine that leads.
  waiting_.push_back({.message = message,
                      .shows = std::move(shows),
                      .camera = from_wire(*frame.camera()),
                      .request_id = frame.request_id(),
                      .came_ns = bus::now_ns()});
  if (waiting_.size() <= kMostWaiting) return;
  drop_unmatched(waiting_.front());
  waiting_.pop_front();
}

void CaptureBridge::use_waiting_frames(std::int64_t now_ns) {
  const std::uint64_t newest = forwarder_.newest_version();
  const bool may_match = std::exchange(tried_version_, newest) != newest;
  std::erase_if(waiting_, [&](const WaitingFrame& waiting) {
    const auto& frame = waiting.message.root<wire::EngineFrame>();
    if (may_match && forwarder_.follow(waiting.shows)) {
      engines_.brought(frame.header()->source()->str(), now_ns);
      ++counters_.frames_followed;
      if (!bus::guarded(waiting.message, [&] { use_frame(frame, waiting.message); })) ++waiting_refused_;
      return true;
    }
    if (now_ns - waiting.came_ns < kWaitNs) return false;
    drop_unmatched(waiting);
    return true;
  });
}

void CaptureBridge::drop_unmatched(const WaitingFrame& frame) {
  ++counters_.frames_unmatched;
  const Camera& camera = frame.camera;
  const bool is_view = camera.role == CameraRole::Input || camera.role == CameraRole::Reference;
  // Its engine has done with the request.
  if (is_view && rigs_.cameras().asks_for(camera.role, camera.id, frame.request_id)) {
    rigs_.reissue(camera.role, camera.id);
  }
}

void CaptureBridge::use_frame(const wire::EngineFrame& frame, const bus::Message& message) {
  // It goes on: an object that comes and goes would have all references rendered anew each time.
  if (forwarder_.masks_objects()) rigs_.ask_for_ids();
  if (!has_picture(frame)) return;  // what moved and nothing else
  switch (frame.camera()->role()) {
    case wire::CameraRole::Input:
      handle_input(message, frame);
      break;
    case wire::CameraRole::Reference: {
      rigs_.references().arrived(frame.camera()->id());
      const bool sent = forwarder_.reference(message, frame);
      sent ? ++counters_.references : ++counters_.frames_lost;
      if (!sent) break;
      references_published_.camera_ids.insert(frame.camera()->id());
      references_published_.last_ns = bus::now_ns();
      refreshed_references_.pictures.arrived(frame.camera()->id(), forwarder_.shown().state->version);
      break;
    }
    case wire::CameraRole::Probe:
      RangeFinder::owns(frame.camera()->id()) ? handle_range(message, frame) : handle_probe_frame(message, frame);
      break;
    case wire::CameraRole::Light:
      // Another engine counts its depth maps by itself.
      if (engines_.leads(frame.header()->source()->str())) handle_light_depth(message, frame);
      break;
    default:
      throw bus::Error(fmt::format("camera role {} does not exist", static_cast<int>(frame.camera()->role())));
  }
}

void CaptureBridge::handle_input(const bus::Message& message, const wire::EngineFrame& frame) {
  const std::uint32_t camera_id = frame.camera()->id();
  InputRig* const rig = rigs_.inputs().awaiting(camera_id, frame.request_id());
  if (rig == nullptr) {
    // Of a camera that waits for its turn in a new place a trainer may have asked for the old one's view.
    const bool asked = rigs_.cameras().asks_for(CameraRole::Input, camera_id, frame.request_id());
    if (asked && options_->input_views) forwarder_.reference(message, frame);
    return;
  }
  auto view = decode_input_frame(message, frame, input_pictures_, host_copied_bytes_);
  if (!view) {
    ++counters_.frames_lost;
    return;
  }
  const std::int64_t now = bus::now_ns();
  if (options_->blind_m > 0 && blindness_.is_blind(*view, options_->blind_m)) {
    ++counters_.inputs_blind;
    rigs_.inputs().blind(*rig, camera_id, now, rigs_.cameras());
    return;
  }
  view->scene_version = forwarder_.shown().state->version;
  view->frame = forwarder_.shown().frame;
  view->time_s = forwarder_.shown().time_s;
  view->objects = forwarder_.shown().state->objects;
  rigs_.inputs().arrived(*rig, camera_id, frame.request_id(), std::make_shared<const InputView>(std::move(*view)), now);
  submit_glance(*rig);
  ++counters_.inputs;
  refreshed_inputs_.pictures.arrived(camera_id, forwarder_.shown().state->version);
  if (options_->input_views && forwarder_.reference(message, frame)) {
    inputs_published_.camera_ids.insert(camera_id);
    inputs_published_.last_ns = now;
  }
}

void CaptureBridge::handle_range(const bus::Message& message, const wire::EngineFrame& frame) {
  const Camera* const camera = rigs_.ranges().awaited(frame.camera()->id(), frame.request_id());
  if (camera == nullptr) return;
  const auto depth = message.tensor("depth", bus::ElementType::F32, {camera->height, camera->width});
  std::vector<float> depth_m(std::size_t{camera->width} * camera->height);
  if (!depth || !depth->copy(depth_m.data())) {
    ++counters_.frames_lost;
    return;
  }
  host_copied_bytes_ += depth->bytes();
  ++counters_.ranges;
  rigs_.ranges().take(camera->id, std::move(depth_m), bus::now_ns(), rigs_.cameras());
}

void CaptureBridge::handle_probe_frame(const bus::Message& message, const wire::EngineFrame& frame) {
  const auto probe = probes_.answer(frame.camera()->id(), frame.request_id());
  if (!probe) return;
  rigs_.cameras().remove(CameraRole::Probe, probe->camera.id);
  forwarder_.probe(message, frame, *probe) ? ++counters_.probes : ++counters_.probes_dropped;
}

void CaptureBridge::handle_light_depth(const bus::Message& message, const wire::EngineFrame& frame) {
  const Camera camera = from_wire(*frame.camera());
  const std::string fault = fault_of(forwarder_.light(), frame.light_id(), frame.light_map(), camera);
  if (!fault.empty()) throw bus::Error(message.topic() + ": " + fault);
  const std::uint32_t maps = rigs_.lights().maps_with(frame.light_id(), frame.light_map(), camera.id);
  if (maps == 0) return;  // of a request that is no more
  if (!forwarder_.light_depth(message, frame, maps, host_copied_bytes_)) {
    ++counters_.frames_lost;
    // While its light rests the engine would not render it again.
    rigs_.cameras().reissue(CameraRole::Light, std::span(&camera.id, 1));
    return;
  }
  ++counters_.light_depths;
  rigs_.lights().saw(frame.light_id(), frame.light_map(), camera);
}

}  // namespace splatbus::capture_bridge
