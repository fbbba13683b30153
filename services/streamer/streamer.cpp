#include "streamer/streamer.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <utility>
#include <zmq.hpp>

#include "bus/clock.h"
#include "bus/trace.h"
#include "stream/bytes.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"
#include "wire/share_topics.h"
#include "wire/system_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::streamer {

namespace {

using namespace std::chrono_literals;

constexpr std::int64_t kSecondNs = 1'000'000'000;
constexpr std::int64_t kIdleNs = 50'000'000;
constexpr std::int64_t kBlockedNs = 5'000'000;  // between tries while a viewer's queue is full
constexpr double kKeepForNobody_s = 60;
constexpr double kUnlimited = 1e18;   // bytes a second
constexpr int kPictureZstdLevel = 1;  // probe pictures are for measurements on the same machine

}  // namespace

Streamer::Streamer(bus::ServiceContext& service)
    : service_(service),
      options_(service.parameters),
      subscriber_(service.bus),
      publisher_(service.bus),
      endpoint_(streamer::endpoints(*options_, service.bus->address(), service.bus->source()),
                {.keys = options_->keys, .silence_s = 3 * options_->hub.viewer_timeout_s}),
      writer_(service.bus->source(), service.bus->epoch()),
      model_(writer_, service.bus->epoch(), options_->stream, service.backend),
      hub_(endpoint_, model_, writer_, options_->hub, events()),
      others_(service.bus->address().is_local()),
      sharing_(service.bus->source(), publisher_, model_, hub_, others_, static_cast<double>(options_->hub.tick_hz)),
      follower_(model_, service.backend) {
  subscribe();
  adopt_handover();
  publish_offer();
  for (const std::string& endpoint : endpoint_.bound()) spdlog::info("viewers connect to {}", endpoint);
}

HubEvents Streamer::events() {
  return {.pose =
              [this](const std::string& viewer, const wire::Pose& body) {
                publisher_.publish(topics::kViewerPose, [&](auto& builder, auto header) {
                  return wire::CreateViewerPoseDirect(builder, header, viewer.c_str(), body.camera());
                });
              },
          .probe =
              [this](const std::string&, const wire::Probe& body) {
                publisher_.publish(topics::kViewerProbe, [&](auto& builder, auto header) {
                  return wire::CreateViewerProbe(builder, header, body.probe_id(), body.camera());
                });
              },
          .quality =
              [this](const std::string& viewer, const wire::Quality& body) {
                publisher_.publish(topics::kViewerQuality, [&](auto& builder, auto header) {
                  return wire::CreateViewerQualityDirect(builder, header, viewer.c_str(), body.probe_id(),
                                                         body.psnr_db(), body.ssim(), body.flip(), body.gaussians(),
                                                         body.first_picture_ns());
                });
              }};
}

void Streamer::run() {
  while (!service_.stop.stop_requested()) wait_and_step();
  drain();
  leave_behind();
}

void Streamer::wait_and_step() {
  std::int64_t due_ns = follower_.busy() ? next_stats_ns_ : std::min(next_tick_ns_, next_stats_ns_);
  due_ns = std::min(due_ns, sharing_.due_ns().value_or(due_ns));
  const std::int64_t wait_ns = std::clamp<std::int64_t>(due_ns - bus::now_ns(), 0, blocked_ ? kBlockedNs : kIdleNs);
  zmq::pollitem_t items[]{{endpoint_.socket(), 0, ZMQ_POLLIN, 0},
                          {subscriber_.zmq_socket(), 0, ZMQ_POLLIN, 0},
                          {nullptr, follower_.descriptor(), ZMQ_POLLIN, 0}};
  zmq::poll(items, 3, std::chrono::milliseconds((wait_ns + 999'999) / 1'000'000));
  step(bus::now_ns());
}

void Streamer::drain() {
  if (hub_.viewers() == 0 || !others_.others_serve(service_.bus->source())) return;
  draining_ = true;
  sharing_.drain();
  publish_offer();
  service_.detail("its viewers move to another streamer");
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(drain_limit_s(options_->drain_s) * 1e9);
  while (hub_.viewers() > 0 && bus::now_ns() < end_ns) wait_and_step();
}

void Streamer::take_messages(std::int64_t now_ns) {
  subscriber_.dispatch_all(0ms);
  if (!follower_.busy()) send_visibility(now_ns);
  pass_updates(now_ns);
  blocked_ = hub_.pump(now_ns);
  sharing_.publish_wants(now_ns);
}

void Streamer::turn(std::int64_t now_ns) {
  step(now_ns);
  if (!follower_.busy()) return;
  follower_.wait();
  end_tick(now_ns);
  take_messages(now_ns);
}

void Streamer::step(std::int64_t now_ns) {
  now_ns_ = now_ns;
  end_tick(now_ns);
  hub_.receive(now_ns);  // before anything is sent: how long the way is, is found from when that is said
  take_messages(now_ns);
  // The first Gaussians do not wait for the tick.
  const bool first = announcement_ && !model_.status().ready && is_followed();
  if (!follower_.busy() && (now_ns >= next_tick_ns_ || first)) {
    if (sharing_.may_begin(now_ns)) {
      begin_tick(now_ns);
      const auto period_ns = static_cast<std::int64_t>(1e9 / static_cast<double>(options_->hub.tick_hz));
      next_tick_ns_ = std::max(next_tick_ns_ + period_ns, now_ns);
      // Replicas of one machine tick together: what they make goes to viewers at once.
      if (sharing_.active()) next_tick_ns_ = (now_ns / period_ns + 1) * period_ns;
    } else {
      next_tick_ns_ = now_ns + kIdleNs;
    }
  }
  blocked_ = hub_.pump(now_ns);
  hub_.expire(now_ns);
  if (next_stats_ns_ == 0) next_stats_ns_ = now_ns + kSecondNs;
  if (now_ns >= next_stats_ns_) {
    endpoint_.require_intact();
    hub_.send_keepalive(now_ns);
    sharing_.publish_still(now_ns);
    publish_statistics(now_ns);
    next_stats_ns_ = std::max(next_stats_ns_ + kSecondNs, now_ns);
  }
}

void Streamer::subscribe() {
  subscriber_
      .on(topics::kStreamerOffer,
          [this](const wire::StreamerOffer& body, const bus::Message&) { others_.take(body, now_ns_); })
      .on(topics::kLiveness,
          [this](const wire::Liveness& body, const bus::Message&) {
            others_.take(body, now_ns_);
            sharing_.take(body);
          })
      .on(topics::kStreamShare,
          [this](const wire::StreamShare& body, const bus::Message&) { sharing_.take(body, now_ns_); })
      .on(topics::kModelPublished,
          [this](const wire::ModelPublished&, const bus::Message& message) { announcement_ = message; })
      .on(topics::kSceneState, [this](const wire::SceneUpdate& body, const bus::Message&) { take_scene(body); })
      .on(topics::kRelightVisibility,
          [this](const wire::RelightVisibility& body, const bus::Message& message) { take_visibility(body, message); })
      .on(topics::kCaptureProbe,
          [this](const wire::CaptureProbe& body, const bus::Message& message) { forward_probe(body, message); });
}

void Streamer::take_scene(const wire::SceneUpdate& body) {
  const wire::SceneState& wired = *body.scene();
  const bus::TracedWork work("send scene", body.header()->capture_ns(), wired.version());
  const SceneState scene = from_wire(wired);
  const auto packet = model_.take_scene(scene, {.frame = wired.frame(), .capture_ns = body.header()->capture_ns()});
  scene_version_ = scene.version;
  hub_.set_objects(scene.objects);
  sharing_.set_scene(scene);
  if (packet) hub_.add_scene(*packet);
}

void Streamer::forward_probe(const wire::CaptureProbe& body, const bus::Message& message) {
  if (hub_.viewers() == 0) return;
  const Camera camera = from_wire(*body.camera());
  const SceneState scene = from_wire(*body.scene());
  const auto color = message.tensor("color", bus::ElementType::U8, {camera.height, camera.width, 4});
  if (!color) return;
  stream::Bytes rgba(color->bytes());
  if (!color->copy(rgba.data())) return;
  hub_.send_probe_picture(body.probe_id(),
                          writer_.write(
                              model_.status().epoch, 0, wire::Body::ProbePicture,
                              [&](auto& builder) {
                                const auto objects_offset = to_wire(builder, scene.objects);
                                const auto light_offset = to_wire(builder, scene.light);
                                return wire::CreateProbePicture(builder, body.probe_id(), body.camera(),
                                                                static_cast<std::uint32_t>(rgba.size()), objects_offset,
                                                                light_offset, scene.version);
                              },
                              stream::zstd_compress(rgba, kPictureZstdLevel), body.header()->capture_ns()));
}

void Streamer::begin_tick(std::int64_t now_ns) {
  // Whoever comes back soon goes on with what it holds.
  if (hub_.empty_s(now_ns) > kKeepForNobody_s && !sharing_.others_are_followed()) model_.release();
  if (!is_followed()) {
    service_.detail(ticked_.opened ? "waits for viewers" : "waits for model/published");
    return;
  }
  if (options_.refresh()) {
    model_.set_schedules(options_->stream.schedules);
    hub_.set_rates(options_->hub.viewer_kbps, options_->hub.join_kbps);
  }
  // What no viewer has room for would only make all of them late.
  const double bytes_per_s = std::min(options_->budget_kbps * 125, sharing_.delta_bytes_per_s().value_or(kUnlimited));
  const double per_tick = bytes_per_s / static_cast<double>(options_->hub.tick_hz);
  balance_bytes_ = std::min(balance_bytes_ + per_tick, per_tick);
  follower_.start({.announcement = std::exchange(announcement_, std::nullopt),
                   .budget_bytes = std::max(balance_bytes_, 0.0),
                   .cameras = sharing_.cameras(),
                   .holders = sharing_.holders(now_ns),
                   .scene_version = scene_version_,
                   .share = sharing_.begin_tick(now_ns)});
}

void Streamer::end_tick(std::int64_t now_ns) {
  const std::optional<ModelFollower::Result> result = follower_.take_result();
  if (!result) return;
  ticked_ = *result;
  ++load_.ticks;
  load_.encode_ms += result->cpu_ms;
  balance_bytes_ -= result->spent_bytes;
  if (result->fresh) observed_generation_ = result->generation;
  // Gaussians that have come since do not know yet what they see.
  stream::StreamUpdate update = model_.take_update();
  const bool others = std::ranges::any_of(update.deltas, [](const stream::DeltaPacket& delta) {
    return std::ranges::any_of(delta.steps, &stream::DeltaPacket::Step::other_lanes);
  });
  const std::size_t gaussians = model_.status().gaussians;
  if (gaussians != std::exchange(held_gaussians_, gaussians) || others) {
    for (auto& [generation, relit] : relit_) relit.sent = false;
  }
  if (result->restarted) {
    sharing_.restart(now_ns);
    hub_.restart_all(sharing_.pages());
    for (auto& [generation, relit] : relit_) relit.sent = false;
  } else {
    sharing_.end_tick(std::move(update), now_ns);
  }
  if (!result->error.empty() && log_limiter_.allow()) spdlog::error("{}", result->error);
  say_what_is_served(*result);
  take_messages(now_ns);
}

void Streamer::pass_updates(std::int64_t now_ns) {
  if (auto update = sharing_.take_due(now_ns)) hub_.add(std::move(*update), sharing_.pages());
}

}  // namespace splatbus::streamer
