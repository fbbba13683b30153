// How a streamer goes on with the stream of the one before it, and leaves its own to the next.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "bus/handover.h"
#include "streamer/streamer.h"
#include "wire/system_generated.h"

namespace splatbus::streamer {

namespace {

using namespace std::chrono_literals;

constexpr std::chrono::milliseconds kPatience = 1s;  // for the broker

}  // namespace

void Streamer::adopt_handover() {
  // Where others serve by now, their stream is the one that viewers are in.
  bus::Subscriber offers(service_.bus);
  offers
      .on(topics::kStreamerOffer,
          [this](const wire::StreamerOffer& body, const bus::Message&) { others_.take(body, bus::now_ns()); })
      .on(topics::kLiveness,
          [this](const wire::Liveness& body, const bus::Message&) { others_.take(body, bus::now_ns()); });
  (void)offers.wait_connected(kPatience);
  offers.dispatch_all(0ms);
  const bool others_serve = others_.others_serve(service_.bus->source());
  try {
    const bool adopted = bus::take_handover(
        *service_.bus,
        [&](std::span<const std::byte> bytes) {
          if (others_serve) return;
          model_.resume(stream::read_handover({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}));
        },
        kPatience);
    if (!adopted || others_serve) return;
  } catch (const std::runtime_error& error) {
    spdlog::warn("viewers load the model anew, as what was left cannot be used: {}", error.what());
    return;
  }
  const SceneState& scene = model_.held().scene;
  scene_version_ = scene.version;
  hub_.set_objects(scene.objects);
  sharing_.set_scene(scene);
  sharing_.restart(bus::now_ns());
  hub_.restart_all(sharing_.pages());
  hub_.await_viewers(bus::now_ns());
  held_gaussians_ = model_.status().gaussians;
  service_.counter("handed_over", static_cast<double>(held_gaussians_));
  spdlog::info("goes on with {} Gaussians in {} pages, as viewers hold them", held_gaussians_, model_.status().pages);
}

// A streamer that is told to end may be one that is restarted: without this the next one would have everybody load all of
// the model again.
void Streamer::leave_behind() {
  constexpr std::size_t kMostGaussians = std::size_t{1} << 21U;  // more would keep whoever ends it waiting
  if (!service_.bus->address().is_local() || !service_.bus->wait_connected(0ms)) return;
  try {
    if (follower_.busy()) {
      follower_.wait();
      end_tick(bus::now_ns());
    }
    const stream::StreamModel::Status held = model_.status();
    // Others that are there have taken over its pages, and have their own.
    if (!held.ready || held.gaussians == 0 || !sharing_.has_all()) return;
    if (held.gaussians > kMostGaussians) {
      spdlog::info("{} Gaussians are not kept for a streamer that comes after: viewers will load them anew",
                   held.gaussians);
      return;
    }
    model_.raise_version(sharing_.newest_version());
    const stream::Bytes bytes = model_.hand_over();
    const bool left = bus::leave_handover(*service_.bus, bytes.size(), [&](std::byte* to) {
      std::ranges::copy(std::as_bytes(std::span(bytes)), to);
    });
    if (left) spdlog::info("handed over {} Gaussians in {} KiB", held.gaussians, bytes.size() >> 10U);
  } catch (const std::exception& error) {
    spdlog::warn("the stream is not kept for a streamer that comes after: {}", error.what());
  }
}

}  // namespace splatbus::streamer
