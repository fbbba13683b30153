// How a streamer goes on with the stream of the one before it, and leaves its own to the next.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <set>
#include <string>

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
  // Where others serve by now, their stream is the one that viewers are in. The broker still has the last offer of
  // those that are gone, so it has to know them as well.
  std::set<std::string> offering, living;
  bus::Subscriber others(service_.bus);
  others
      .on(topics::kStreamerOffer,
          [&](const wire::StreamerOffer& body, const bus::Message& message) {
            if (!body.draining()) offering.insert(message.header().source()->str());
          })
      .on(topics::kLiveness, [&](const wire::Liveness& body, const bus::Message&) {
        if (body.nodes() == nullptr) return;
        for (const auto* node : *body.nodes()) {
          if (node->alive()) living.insert(node->source()->str());
        }
      });
  if (!others.wait_connected(kPatience)) return;
  others.dispatch_all(0ms);
  const auto other = std::ranges::find_if(
      offering, [&](const std::string& source) { return source != service_.bus->source() && living.contains(source); });
  try {
    const bool adopted = bus::take_handover(*service_.bus, [&](std::span<const std::byte> bytes) {
      if (other != offering.end()) {
        spdlog::info("begins anew and not where the one before has ended: {} serves meanwhile", *other);
        return;
      }
      model_.resume(stream::read_handover({reinterpret_cast<const std::uint8_t*>(bytes.data()), bytes.size()}));
    });
    if (!adopted || other != offering.end()) return;
  } catch (const std::exception& error) {
    spdlog::warn("viewers load the model anew, as what was left cannot be used: {}", error.what());
    return;
  }
  const SceneState& scene = model_.held().scene;
  scene_version_ = scene.version;
  hub_.set_objects(scene.objects);
  sharing_.set_scene(scene);
  sharing_.restart(bus::now_ns());
  hub_.restart_all(sharing_.pages());
  hub_.await_viewers_of_before(bus::now_ns());
  held_gaussians_ = model_.status().gaussians;
  service_.counter("handed_over", static_cast<double>(held_gaussians_));
  spdlog::info("goes on with {} Gaussians in {} pages, as viewers hold them", held_gaussians_, model_.status().pages);
}

// A streamer that is told to end may be one that is restarted: without this the next one would have everybody load all
// of the model again.
void Streamer::leave_behind() {
  // More would keep whoever ends it waiting, who does that for long only where another one is ready.
  const std::size_t most_gaussians = std::size_t{1} << (service_.yields() ? 21U : 19U);
  if (!service_.bus->address().is_local() || !service_.bus->wait_connected(0ms)) return;
  try {
    if (follower_.busy()) {
      follower_.wait();
      end_tick(bus::now_ns());
    }
    const stream::StreamModel::Status held = model_.status();
    // Others that are there have taken over its pages, and have their own.
    if (!held.ready || held.gaussians == 0 || !sharing_.has_all()) return;
    if (held.gaussians > most_gaussians) {
      spdlog::info("{} Gaussians are not kept for a streamer that comes after: viewers will load them anew",
                   held.gaussians);
      return;
    }
    model_.raise_version(sharing_.newest_version());
    const stream::Bytes bytes = model_.hand_over();
    const bool left = bus::leave_handover(
        *service_.bus, bytes.size(), [&](std::byte* to) { std::ranges::copy(std::as_bytes(std::span(bytes)), to); });
    if (left) spdlog::info("handed over {} Gaussians in {} KiB", held.gaussians, bytes.size() >> 10U);
  } catch (const std::exception& error) {
    spdlog::warn("the stream is not kept for a streamer that comes after: {}", error.what());
  }
}

}  // namespace splatbus::streamer
