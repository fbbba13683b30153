// What the streamer says of itself.

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>

#include "bus/clock.h"
#include "streamer/streamer.h"
#include "wire/stream_generated.h"
#include "wire/topics.h"

namespace splatbus::streamer {

void Streamer::say_what_is_served(const ModelFollower::Result& result) {
  const stream::StreamModel::Status status = model_.status();
  if (!status.ready) {
    service_.detail("waits for Gaussians");
    return;
  }
  if (result.full && !full_) {
    spdlog::warn("{} of {} Gaussians are served: viewers take no more", status.gaussians, result.observed);
  }
  full_ = result.full;
  service_.detail(
      full_ ? fmt::format("streams {} of {} Gaussians to {} viewers", status.gaussians, result.observed, hub_.viewers())
            : fmt::format("streams to {} viewers", hub_.viewers()));
}

void Streamer::close_load(const WireStatistics::Window& window) {
  const std::int64_t cpu_ns = bus::thread_cpu_ns();
  const double send_ms = static_cast<double>(cpu_ns - load_.begin_cpu_ns) / 1e6;
  const double tick_ms = 1e3 / static_cast<double>(options_->hub.tick_hz);
  const double seconds = window.seconds > 0 ? window.seconds : 1;
  const double ticks = load_.ticks > 0 ? load_.ticks : 1e3 * seconds / tick_ms;
  load_ = {.ticks = 0,
           .encode_ms = 0,
           .begin_cpu_ns = cpu_ns,
           .encode_ms_a_tick = load_.encode_ms / ticks,
           .send_ms_a_tick = load_.begin_cpu_ns == 0 ? 0 : send_ms / ticks,
           .tick_ms = tick_ms,
           .bytes_per_s = static_cast<double>(window.bytes) / seconds};
}

void Streamer::publish_offer() {
  const std::vector<std::string> endpoints = offered_endpoints(*options_, endpoint_.bound());
  publisher_.publish(topics::kStreamerOffer, {.latch_key = service_.bus->source()}, [&](auto& builder, auto header) {
    return wire::CreateStreamerOffer(builder, header, builder.CreateVectorOfStrings(endpoints),
                                     static_cast<std::uint32_t>(hub_.viewers()),
                                     static_cast<std::uint32_t>(options_->hub.max_viewers),
                                     static_cast<float>(load_.tick_ms), static_cast<float>(load_.encode_ms_a_tick),
                                     static_cast<float>(load_.send_ms_a_tick), load_.bytes_per_s, draining_);
  });
}

void Streamer::publish_statistics(std::int64_t now_ns) {
  const auto window = hub_.statistics().close_window(now_ns);
  const stream::StreamModel::Status held = model_.status();
  const ViewerHub::Counts counts = hub_.counts();
  publisher_.publish(topics::kStreamStats, [&](auto& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::PacketBytes>> types;
    for (std::size_t i = 0; i < window.types.size(); ++i) {
      const auto& type = window.types[i];
      if (type.packets == 0) continue;
      types.push_back(wire::CreatePacketBytesDirect(builder, wire::EnumNameBody(static_cast<wire::Body>(i)),
                                                    type.total_bytes, type.window_bytes, type.packets));
    }
    return wire::CreateStreamStatsDirect(builder, header, held.epoch, held.version, hub_.pages(),
                                         static_cast<std::uint32_t>(hub_.viewers()), hub_.gaussians(), ticked_.observed,
                                         window.total_bytes, window.bytes, window.seconds, window.mbps,
                                         window.mbps_mean, window.mbps_peak, counts.whole_pages, counts.lost_packets,
                                         counts.refused_pages, hub_.lost_viewers(), &types);
  });
  close_load(window);
  publish_offer();
  service_.counter("viewers", static_cast<double>(hub_.viewers()));
  service_.counter("encode_ms", load_.encode_ms_a_tick);
  service_.counter("send_ms", load_.send_ms_a_tick);
  service_.counter("bytes_per_s", load_.bytes_per_s);
  service_.counter("gaussians", static_cast<double>(hub_.gaussians()));
  service_.counter("unsent_gaussians", static_cast<double>(ticked_.unsent));
  service_.counter("pending_deltas", static_cast<double>(ticked_.pending_deltas));
  service_.counter("tick_ms", ticked_.ms);
  service_.counter("host_copied_bytes", static_cast<double>(ticked_.host_copied_bytes));
  service_.counter("observed_bytes", static_cast<double>(ticked_.observed_bytes));
  service_.counter("wire_mbps", window.mbps);
  service_.counter("wire_mbps_mean", window.mbps_mean);
  service_.counter("wire_mbps_peak", window.mbps_peak);
  service_.counter("wire_bytes", static_cast<double>(window.total_bytes));
  service_.counter("pages", static_cast<double>(hub_.pages()));
  service_.counter("own_pages", static_cast<double>(held.pages));
  service_.counter("replicas", static_cast<double>(sharing_.replicas()));
  service_.counter("whole_pages", static_cast<double>(counts.whole_pages));
  service_.counter("lost_packets", static_cast<double>(counts.lost_packets));
  service_.counter("refused_pages", static_cast<double>(counts.refused_pages));
  service_.counter("ignored", static_cast<double>(hub_.ignored()));
  service_.counter("lost_viewers", static_cast<double>(hub_.lost_viewers()));
  service_.counter("tcp_connections", static_cast<double>(endpoint_.connections().open));
  service_.counter("closed_connections", static_cast<double>(endpoint_.connections().closed));
  service_.counter("malformed", static_cast<double>(endpoint_.malformed()));
  for (std::size_t i = 0; i < window.types.size(); ++i) {
    if (window.types[i].packets == 0) continue;
    service_.counter(fmt::format("wire_bytes_{}", wire::EnumNameBody(static_cast<wire::Body>(i))),
                     static_cast<double>(window.types[i].total_bytes));
  }
}

}  // namespace splatbus::streamer
