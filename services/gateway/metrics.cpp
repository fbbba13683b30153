#include "gateway/metrics.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <sstream>
#include <utility>
#include <vector>

namespace splatbus::gateway {

namespace {

using Label = prometheus::ClientMetric::Label;

/// Families in the order in which they are added.
class Families {
 public:
  void gauge(const std::string& name, const std::string& help, double value, std::vector<Label> labels = {}) {
    prometheus::ClientMetric metric;
    metric.label = std::move(labels);
    metric.gauge.value = value;
    family(name, help, prometheus::MetricType::Gauge).metric.push_back(std::move(metric));
  }
  template <class Number>
  void counter(const std::string& name, const std::string& help, Number value, std::vector<Label> labels = {}) {
    prometheus::ClientMetric metric;
    metric.label = std::move(labels);
    metric.counter.value = static_cast<double>(value);
    family(name, help, prometheus::MetricType::Counter).metric.push_back(std::move(metric));
  }
  [[nodiscard]] std::string text() const {
    std::ostringstream out;
    prometheus::TextSerializer().Serialize(out, families_);
    return out.str();
  }

 private:
  prometheus::MetricFamily& family(const std::string& name, const std::string& help, prometheus::MetricType type) {
    if (families_.empty() || families_.back().name != name) {
      families_.emplace_back();
      families_.back().name = name;
      families_.back().help = help;
      families_.back().type = type;
    }
    return families_.back();
  }

  std::vector<prometheus::MetricFamily> families_;
};

void add_services(Families& out, const std::vector<ServiceFigures>& services) {
  const auto labels = [](const ServiceFigures& s) {
    return std::vector<Label>{{"service", s.kind}, {"source", s.source}};
  };
  for (const auto& s : services) out.gauge("splatbus_up", "1 while a service is alive", s.alive ? 1 : 0, labels(s));
  for (const auto& s : services) {
    out.gauge("splatbus_heartbeat_age_seconds", "Since a service's last heartbeat", s.age_s, labels(s));
  }
}

void add_stream(Families& out, const StreamFigures& stream) {
  out.gauge("splatbus_stream_viewers", "Viewers that are served", stream.viewers);
  out.gauge("splatbus_stream_gaussians", "Gaussians that viewers hold", static_cast<double>(stream.gaussians));
  out.gauge("splatbus_stream_model_gaussians", "Gaussians of the model that is streamed",
            static_cast<double>(stream.model_gaussians));
  for (const auto& [body, type] : stream.by_type) {
    out.counter("splatbus_stream_bytes_total", "Sent to viewers, by packet type", type.bytes, {{"body", body}});
  }
  for (const auto& [body, type] : stream.by_type) {
    out.counter("splatbus_stream_packets_total", "Sent to viewers, by packet type", type.packets, {{"body", body}});
  }
  out.counter("splatbus_stream_whole_pages_total", "Whole pages sent", stream.whole_pages);
  out.counter("splatbus_stream_lost_packets_total", "Packets that viewers did not get", stream.lost_packets);
  out.counter("splatbus_stream_lost_viewers_total", "Viewers that fell silent or did not read", stream.lost_viewers);
}

void add_trainer(Families& out, const TrainerFigures& trainer) {
  out.counter("splatbus_trainer_steps_total", "Optimizer steps", trainer.step);
  out.counter("splatbus_trainer_views_total", "Views trained on", trainer.views);
  out.gauge("splatbus_trainer_steps_per_second", "Over the last second of optimizer time", trainer.steps_per_s);
  out.gauge("splatbus_trainer_loss", "Exponential mean", trainer.loss);
  const std::string gaussians = "splatbus_trainer_gaussians";
  for (const auto& [state, count] : {std::pair("active", trainer.active), std::pair("frozen", trainer.frozen),
                                     std::pair("spilled", trainer.spilled)}) {
    out.gauge(gaussians, "Gaussians of the world, by state", static_cast<double>(count), {{"state", state}});
  }
  for (const auto& [state, count] :
       {std::pair("active", trainer.pages_active), std::pair("frozen", trainer.pages_frozen),
        std::pair("spilled", trainer.pages_spilled)}) {
    out.gauge("splatbus_trainer_pages", "Pages of the world, by state", count, {{"state", state}});
  }
  for (const auto& [memory, bytes] : {std::pair("device", trainer.device_bytes), std::pair("host", trainer.host_bytes),
                                      std::pair("disk", trainer.disk_bytes)}) {
    out.gauge("splatbus_trainer_memory_bytes", "The model and all that is kept of it", static_cast<double>(bytes),
              {{"memory", memory}});
  }
  out.gauge("splatbus_trainer_paused", "1 while the trainer rests", trainer.paused ? 1 : 0);
}

void add_gateway(Families& out, const Traffic& traffic) {
  out.gauge("splatbus_gateway_connections", "Connections to the gateway", static_cast<double>(traffic.connections));
  out.gauge("splatbus_gateway_viewers", "Browsers that view the stream", static_cast<double>(traffic.viewers));
  out.gauge("splatbus_gateway_queued_bytes", "Of packets that are being written to browsers",
            static_cast<double>(traffic.queued_bytes));
  out.counter("splatbus_gateway_requests_total", "HTTP requests", traffic.requests);
  out.counter("splatbus_gateway_moves_total", "Browsers that went on with another streamer", traffic.moves);
  out.counter("splatbus_gateway_pages_served_total", "Frozen pages sent over HTTP", traffic.pages_served);
  out.counter("splatbus_gateway_pages_fetched_total", "Frozen pages asked of the streamer, to be sent over HTTP",
              traffic.pages_fetched);
  out.gauge("splatbus_gateway_page_cache_bytes", "Of pages that are kept to be served again",
            static_cast<double>(traffic.page_bytes));
  out.counter("splatbus_gateway_exports_total", "Files made of the live model", traffic.exports);
  out.gauge("splatbus_gateway_foxglove_clients", "Clients of Foxglove's protocol",
            static_cast<double>(traffic.foxglove.clients));
  out.gauge("splatbus_gateway_foxglove_queued_bytes", "Of messages that wait for such clients",
            static_cast<double>(traffic.foxglove.queued_bytes));
  out.counter("splatbus_gateway_foxglove_dropped_total", "Messages that slow clients were not sent",
              traffic.foxglove.dropped);
  const std::vector<Label> from{{"direction", "from_browser"}}, to{{"direction", "to_browser"}};
  const std::string bytes = "splatbus_gateway_bytes_total", messages = "splatbus_gateway_messages_total";
  out.counter(bytes, "Of WebSocket messages", traffic.bytes_from, from);
  out.counter(bytes, "Of WebSocket messages", traffic.bytes_to, to);
  out.counter(messages, "WebSocket messages", traffic.messages_from, from);
  out.counter(messages, "WebSocket messages", traffic.messages_to, to);
  for (std::size_t i = 0; i < kRefusalNames.size(); ++i) {
    out.counter("splatbus_gateway_refused_total", "Connections, requests and messages turned away", traffic.refused[i],
                {{"reason", std::string(kRefusalNames[i])}});
  }
}

}  // namespace

std::string metrics_text(const PipelineView& pipeline, const Traffic& traffic, std::int64_t now_ns) {
  Families out;
  add_services(out, pipeline.services(now_ns));
  if (const auto stream = pipeline.stream(now_ns)) add_stream(out, *stream);
  if (const auto* quality = pipeline.quality(now_ns)) {
    out.gauge("splatbus_stream_ssim",
              "A viewer's picture against the engine's, the newest comparison; absent after 10 s without one",
              quality->ssim);
    out.gauge("splatbus_stream_psnr_db", "PSNR of the same pictures, dB", quality->psnr_db);
  }
  if (const auto* trainer = pipeline.trainer(now_ns)) add_trainer(out, *trainer);
  add_gateway(out, traffic);
  return out.text();
}

nlohmann::json status_json(const PipelineView& pipeline, const Traffic& traffic, const BenchLog& bench,
                           std::int64_t now_ns) {
  using Json = nlohmann::json;
  const std::string ill = pipeline.ill_because(now_ns);
  Json status{{"healthy", ill.empty()}, {"services", Json::array()}, {"bench", Json::array()}};
  if (!ill.empty()) status["reason"] = ill;
  for (const auto& s : pipeline.services(now_ns)) {
    status["services"].push_back({{"source", s.source},
                                  {"service", s.kind},
                                  {"state", s.state},
                                  {"alive", s.alive},
                                  {"heartbeat_age_s", s.age_s},
                                  {"pid", s.pid},
                                  {"backend", s.backend},
                                  {"detail", s.detail},
                                  {"counters", s.counters}});
  }
  if (const auto s = pipeline.stream(now_ns)) {
    Json types = Json::object();
    for (const auto& [body, type] : s->by_type) types[body] = {{"packets", type.packets}, {"bytes", type.bytes}};
    status["stream"] = {{"viewers", s->viewers},
                        {"gaussians", s->gaussians},
                        {"model_gaussians", s->model_gaussians},
                        {"version", s->version},
                        {"pages", s->pages},
                        {"total_bytes", s->total_bytes},
                        {"wire_mbps", s->wire_mbps},
                        {"wire_mbps_mean", s->wire_mbps_mean},
                        {"wire_mbps_peak", s->wire_mbps_peak},
                        {"whole_pages", s->whole_pages},
                        {"lost_packets", s->lost_packets},
                        {"lost_viewers", s->lost_viewers},
                        {"by_type", types}};
  }
  if (const auto* t = pipeline.trainer(now_ns)) {
    status["trainer"] = {{"step", t->step},
                         {"steps_per_s", t->steps_per_s},
                         {"views_per_s", t->views_per_s},
                         {"loss", t->loss},
                         {"gaussians", t->gaussians},
                         {"active", t->active},
                         {"frozen", t->frozen},
                         {"spilled", t->spilled},
                         {"paused", t->paused},
                         {"device_bytes", t->device_bytes},
                         {"host_bytes", t->host_bytes},
                         {"disk_bytes", t->disk_bytes}};
  }
  if (const auto* q = pipeline.quality(now_ns)) {
    status["quality"] = {{"ssim", q->ssim}, {"psnr_db", q->psnr_db}, {"flip", q->flip}};
  }
  Json refused = Json::object();
  for (std::size_t i = 0; i < kRefusalNames.size(); ++i) refused[std::string(kRefusalNames[i])] = traffic.refused[i];
  status["gateway"] = {{"connections", traffic.connections},
                       {"viewers", traffic.viewers},
                       {"queued_bytes", traffic.queued_bytes},
                       {"bytes_from_browsers", traffic.bytes_from},
                       {"bytes_to_browsers", traffic.bytes_to},
                       {"messages_from_browsers", traffic.messages_from},
                       {"messages_to_browsers", traffic.messages_to},
                       {"requests", traffic.requests},
                       {"pages_served", traffic.pages_served},
                       {"pages_fetched", traffic.pages_fetched},
                       {"page_cache_bytes", traffic.page_bytes},
                       {"exports", traffic.exports},
                       {"foxglove",
                        {{"clients", traffic.foxglove.clients},
                         {"queued_bytes", traffic.foxglove.queued_bytes},
                         {"dropped", traffic.foxglove.dropped}}},
                       {"refused", refused}};
  for (const auto& report : bench.reports()) status["bench"].push_back(report);
  return status;
}

}  // namespace splatbus::gateway
