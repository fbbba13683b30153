#include "gateway/pipeline_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "bus/frames.h"
#include "wire/model_generated.h"
#include "wire/stream_generated.h"
#include "wire/system_generated.h"
#include "wire/viewer_generated.h"

namespace splatbus::gateway {

namespace {

constexpr std::size_t kMaxServices = 64, kMaxCounters = 64, kMaxTypes = 32, kMaxDetail = 256;
constexpr std::size_t kMessagesACall = 1024;
constexpr double kPatienceS = 3;

StreamCounts counts_of(const wire::StreamStats& stats) {
  StreamCounts counts{.total_bytes = stats.total_bytes(),
                      .whole_pages = stats.whole_pages(),
                      .lost_packets = stats.lost_packets(),
                      .lost_viewers = stats.lost_viewers(),
                      .by_type = {}};
  if (stats.by_type() == nullptr) return counts;
  for (const auto* type : *stats.by_type()) {
    if (counts.by_type.size() == kMaxTypes) break;
    counts.by_type[bus::printable(type->body()->string_view())] = {type->packets(), type->total_bytes()};
  }
  return counts;
}

StreamFigures figures_of(const wire::StreamStats& stats) {
  StreamFigures figures{counts_of(stats)};
  figures.epoch = stats.stream_epoch();
  figures.version = stats.version();
  figures.pages = stats.pages();
  figures.gaussians = stats.gaussians();
  figures.model_gaussians = stats.model_gaussians();
  figures.viewers = stats.viewers();
  figures.wire_mbps = stats.wire_mbps();
  figures.wire_mbps_mean = stats.wire_mbps_mean();
  figures.wire_mbps_peak = stats.wire_mbps_peak();
  return figures;
}

/// All of it where the counter began anew.
std::uint64_t increase(std::uint64_t before, std::uint64_t now) {
  return now >= before ? now - before : now;
}

void add_increase(StreamCounts& all, const StreamCounts& before, const StreamCounts& now) {
  for (const auto counter : {&StreamCounts::total_bytes, &StreamCounts::whole_pages, &StreamCounts::lost_packets,
                             &StreamCounts::lost_viewers}) {
    all.*counter += increase(before.*counter, now.*counter);
  }
  for (const auto& [name, type] : now.by_type) {
    if (!all.by_type.contains(name) && all.by_type.size() == kMaxTypes) continue;
    const auto found = before.by_type.find(name);
    const StreamCounts::Type was = found != before.by_type.end() ? found->second : StreamCounts::Type{};
    StreamCounts::Type& sum = all.by_type[name];
    sum.packets += increase(was.packets, type.packets);
    sum.bytes += increase(was.bytes, type.bytes);
  }
}

TrainerFigures figures_of(const wire::TrainerStats& stats) {
  return {.step = stats.step(),
          .views = stats.views(),
          .gaussians = stats.gaussians(),
          .active = stats.active(),
          .frozen = stats.frozen(),
          .spilled = stats.spilled(),
          .unpaired_views = stats.unpaired_views(),
          .device_bytes = stats.device_bytes(),
          .host_bytes = stats.host_bytes(),
          .disk_bytes = stats.disk_bytes(),
          .pages_active = stats.pages_active(),
          .pages_frozen = stats.pages_frozen(),
          .pages_spilled = stats.pages_spilled(),
          .ready_references = stats.ready_references(),
          .ready_inputs = stats.ready_inputs(),
          .steps_per_s = stats.steps_per_s(),
          .views_per_s = stats.views_per_s(),
          .loss = stats.loss(),
          .masked_share = stats.masked_share(),
          .paused = stats.paused()};
}

}  // namespace

PipelineView::PipelineView(std::shared_ptr<bus::Context> context) : subscriber_(std::move(context)) {
  using bus::Message;
  subscriber_.on(topics::kHeartbeat, [this](const wire::Heartbeat& body, const Message&) { take_heartbeat(body); })
      .on(topics::kLiveness, [this](const wire::Liveness& body, const Message& m) { take_liveness(body, m); })
      .on(topics::kStreamStats, [this](const wire::StreamStats& body, const Message& m) { take_stream(body, m); })
      .on(topics::kTrainerStats,
          [this](const wire::TrainerStats& body, const Message&) {
            trainer_ = {figures_of(body), now_ns_};
          })
      .on(topics::kViewerQuality, [this](const wire::ViewerQuality& body, const Message&) {
        quality_ = {QualityFigures{.ssim = body.ssim(), .psnr_db = body.psnr_db(), .flip = body.flip()}, now_ns_};
      });
}

void PipelineView::poll(std::int64_t now_ns) {
  now_ns_ = now_ns;
  subscriber_.dispatch_all(std::chrono::milliseconds(0), kMessagesACall);
}

std::optional<StreamFigures> PipelineView::stream(std::int64_t now_ns) const {
  std::optional<StreamFigures> all;
  for (const auto& [source, streamer] : streams_) {
    const StreamFigures* one = fresh(streamer.heard, now_ns);
    if (one == nullptr) continue;
    if (!all) {
      all = *one;
      continue;
    }
    const StreamFigures before = *all;
    if (one->epoch > all->epoch) all = *one;
    all->viewers = before.viewers + one->viewers;
    all->wire_mbps = before.wire_mbps + one->wire_mbps;
    all->wire_mbps_mean = before.wire_mbps_mean + one->wire_mbps_mean;
    all->wire_mbps_peak = before.wire_mbps_peak + one->wire_mbps_peak;
  }
  if (all) static_cast<StreamCounts&>(*all) = counted_;
  return all;
}

void PipelineView::take_stream(const wire::StreamStats& stats, const bus::Message& message) {
  const std::string source = message.header().source()->str();
  if (!streams_.contains(source) && !make_room_for_streamer()) return;
  Streamer& streamer = streams_[source];
  const std::uint64_t start = message.header().epoch();
  const StreamFigures now = figures_of(stats);
  const bool same_process = streamer.heard.figures && streamer.start == start;
  add_increase(counted_, same_process ? *streamer.heard.figures : StreamFigures{}, now);
  streamer = {.heard = {now, now_ns_}, .start = start};
}

bool PipelineView::make_room_for_streamer() {
  if (streams_.size() < kMaxServices) return true;
  const auto oldest = std::min_element(streams_.begin(), streams_.end(), [](const auto& a, const auto& b) {
    return a.second.heard.heard_ns < b.second.heard.heard_ns;
  });
  if (fresh(oldest->second.heard, now_ns_) != nullptr) return false;
  streams_.erase(oldest);
  return true;
}

void PipelineView::take_heartbeat(const wire::Heartbeat& heartbeat) {
  const std::string source = bus::printable(heartbeat.header()->source()->string_view());
  if (!beats_.contains(source) && beats_.size() >= kMaxServices) return;
  ServiceFigures& figures = beats_[source];
  figures.detail = heartbeat.detail() ? bus::printable(heartbeat.detail()->string_view(), kMaxDetail) : "";
  figures.backend = heartbeat.backend() ? bus::printable(heartbeat.backend()->string_view()) : "";
  figures.counters.clear();
  if (heartbeat.counters() == nullptr) return;
  for (const auto* counter : *heartbeat.counters()) {
    if (figures.counters.size() == kMaxCounters) break;
    figures.counters[bus::printable(counter->name()->string_view())] = counter->value();
  }
}

void PipelineView::take_liveness(const wire::Liveness& liveness, const bus::Message& message) {
  liveness_ns_ = message.header().resent() ? 0 : now_ns_;
  nodes_.clear();
  if (liveness.nodes() == nullptr) return;
  for (const auto* node : *liveness.nodes()) {
    if (nodes_.size() == kMaxServices) break;
    nodes_.push_back({.source = bus::printable(node->source()->string_view()),
                      .kind = bus::printable(node->service()->string_view()),
                      .state = wire::EnumNameServiceState(node->state()),
                      .pid = node->pid(),
                      .alive = node->alive(),
                      .age_s = node->age_s()});
  }
  std::erase_if(beats_, [&](const auto& beat) {
    return std::none_of(nodes_.begin(), nodes_.end(), [&](const auto& node) { return node.source == beat.first; });
  });
}

std::vector<ServiceFigures> PipelineView::services(std::int64_t now_ns) const {
  std::vector<ServiceFigures> services = nodes_;
  const double since_s = liveness_ns_ == 0 ? 0 : static_cast<double>(now_ns - liveness_ns_) / 1e9;
  for (ServiceFigures& service : services) {
    service.age_s += since_s;
    const auto beat = beats_.find(service.source);
    if (beat == beats_.end()) continue;
    service.detail = beat->second.detail;
    service.backend = beat->second.backend;
    service.counters = beat->second.counters;
  }
  return services;
}

std::string PipelineView::ill_because(std::int64_t now_ns) const {
  if (liveness_ns_ == 0 || static_cast<double>(now_ns - liveness_ns_) / 1e9 > kPatienceS) return "the bus is silent";
  const auto services = this->services(now_ns);
  const bool streams = std::any_of(services.begin(), services.end(), [](const ServiceFigures& service) {
    return service.kind == "streamer" && service.alive && service.age_s < kPatienceS;
  });
  return streams ? "" : "no streamer is alive";
}

}  // namespace splatbus::gateway
