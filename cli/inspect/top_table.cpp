#include "top_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>

#include "bus/clock.h"
#include "control_request.h"
#include "control_socket.h"
#include "process_memory.h"
#include "units_text.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
constexpr double kMebibyte = 1024.0 * 1024;
constexpr double kTopPatienceS = 0.5;  // keys are not looked at meanwhile

std::map<std::string, int> restarts_of(const bus::Address& bus) {
  std::map<std::string, int> restarts;
  try {
    const Json answer = ask_supervisor(bus, {{"verb", "status"}}, {}, kTopPatienceS);
    for (const Json& process : answer.at("services")) {
      restarts[process.value("name", "")] = process.value("restarts", 0);
    }
  } catch (const std::exception&) {
    // There is none, it is on its way out, or does not answer: the column stays empty.
  }
  return restarts;
}

template <class Value>
Json or_null(const std::optional<Value>& value) {
  return value ? Json(*value) : Json(nullptr);
}

std::string cell(const std::optional<double>& value, const char* format = "{:.0f}") {
  return value ? fmt::format(fmt::runtime(format), *value) : "-";
}

std::string in_ms(const Summary& summary, double value_s) {
  return summary.count == 0 ? "-" : fmt::format("{:.2f}", value_s * 1e3);
}

}  // namespace

TopSampler::TopSampler(std::shared_ptr<bus::Context> context, bus::Address address)
    : watch_(std::move(context)), address_(std::move(address)) {}

void TopSampler::sample_gpus() {
  using std::chrono::seconds;
  if (!has_gpus_) return;
  if (pending_gpus_.valid()) {
    if (pending_gpus_.wait_for(seconds(0)) != std::future_status::ready) return;
    gpus_ = pending_gpus_.get();
    has_gpus_ = !gpus_.devices.empty();
    if (!has_gpus_) return;
  }
  // Aside, since nvidia-smi may take a second.
  pending_gpus_ = std::async(std::launch::async, [] {
    Gpus gpus{.devices = query_gpus(), .process_mib = {}};
    if (!gpus.devices.empty()) gpus.process_mib = query_gpu_memory();
    return gpus;
  });
}

void TopSampler::add_loads(TopService& service, std::map<std::uint32_t, double>& processor_s) {
  if (!address_.is_local() || !service.alive || service.pid == 0) return;
  const auto pid = static_cast<pid_t>(service.pid);
  if (const auto bytes = own_bytes(pid)) service.memory_bytes = static_cast<double>(*bytes);
  if (const auto found = gpus_.process_mib.find(service.pid); found != gpus_.process_mib.end()) {
    service.gpu_bytes = found->second * kMebibyte;
  }
  const auto seconds = processor_seconds(pid);
  if (!seconds) return;
  processor_s[service.pid] = *seconds;
  const auto before = processor_s_.find(service.pid);
  if (before == processor_s_.end() || viewed_ns_ == 0) return;
  const double elapsed_s = static_cast<double>(bus::now_ns() - viewed_ns_) / 1e9;
  if (elapsed_s > 0) service.processor_percent = 100 * std::max(0.0, *seconds - before->second) / elapsed_s;
}

TopView TopSampler::view() {
  TopView view{.bus = address_.text()};
  const TopicSnapshot none;
  const TopicSnapshot& now = watch_.topics() ? *watch_.topics() : none;
  const TopicSnapshot& before = watch_.topics_before() ? *watch_.topics_before() : now;
  view.interval_s = static_cast<double>(now.published_ns - before.published_ns) / 1e9;

  std::map<std::string, double> rates = source_rates(before, now);
  for (const auto& [name, seen] : now.topics) {
    TopTopic topic{.name = name, .traffic = traffic_between(before, now, name), .readers = seen.subscribers.size()};
    view.topics.push_back(std::move(topic));
  }
  std::stable_sort(view.topics.begin(), view.topics.end(), [](const TopTopic& a, const TopTopic& b) {
    const Summary &left = a.traffic.ages, &right = b.traffic.ages;
    if ((left.count > 0) != (right.count > 0)) return left.count > 0;
    return left.count > 0 && left.mean_s < right.mean_s;
  });

  sample_gpus();
  view.gpus = gpus_.devices;
  const std::map<std::string, int> restarts = restarts_of(address_);
  std::map<std::uint32_t, double> processor_s;
  for (const auto& [source, node] : watch_.nodes()) {
    TopService service{.name = source,
                       .state = node.alive ? node.state : "gone",
                       .backend = node.backend,
                       .detail = node.detail,
                       .pid = node.pid,
                       .alive = node.alive,
                       .rate_hz = rates[source],
                       .drops = drops_of(node)};
    if (const auto found = restarts.find(source); found != restarts.end()) service.restarts = found->second;
    add_loads(service, processor_s);
    view.services.push_back(std::move(service));
  }
  processor_s_ = std::move(processor_s);
  viewed_ns_ = bus::now_ns();
  return view;
}

void sort_services(TopView& view, TopOrder order) {
  const auto key = [order](const TopService& service) {
    switch (order) {
      case TopOrder::Name:
        return 0.0;
      case TopOrder::Processor:
        return service.processor_percent.value_or(-1);
      case TopOrder::Memory:
        return service.memory_bytes.value_or(-1);
      case TopOrder::Rate:
        return service.rate_hz;
      case TopOrder::Drops:
        return service.drops;
    }
    return 0.0;
  };
  std::sort(view.services.begin(), view.services.end(), [&](const TopService& a, const TopService& b) {
    const double left = key(a), right = key(b);
    return left != right ? left > right : a.name < b.name;
  });
}

std::vector<std::string> top_lines(const TopView& view) {
  std::size_t width = 7;
  for (const TopService& service : view.services) width = std::max(width, service.name.size());
  std::vector<std::string> lines;
  double processor = 0, memory = 0;
  for (const TopService& service : view.services) {
    processor += service.processor_percent.value_or(0);
    memory += service.memory_bytes.value_or(0);
  }
  lines.push_back(fmt::format("{}: {} services, CPU {:.0f} %, memory {}", view.bus, view.services.size(), processor,
                              bytes_text(memory)));
  for (const GpuUsage& gpu : view.gpus) {
    lines.push_back(
        fmt::format("{}: {:.0f} %, {:.0f} of {:.0f} MiB", gpu.name, gpu.busy_percent, gpu.used_mib, gpu.total_mib));
  }
  lines.emplace_back();
  lines.push_back(fmt::format("{:<{}} {:>8} {:<9} {:<7} {:>6} {:>11} {:>9} {:>8} {:>8} {:>8}  {}", "SERVICE", width,
                              "PID", "STATE", "BACKEND", "CPU %", "MEMORY", "GPU MiB", "HZ", "DROPS", "RESTARTS",
                              "DETAIL"));
  for (const TopService& s : view.services) {
    lines.push_back(fmt::format("{:<{}} {:>8} {:<9} {:<7} {:>6} {:>11} {:>9} {:>8.1f} {:>8.0f} {:>8}  {}", s.name,
                                width, s.pid, s.state, s.backend.empty() ? "-" : s.backend, cell(s.processor_percent),
                                s.memory_bytes ? bytes_text(*s.memory_bytes) : "-",
                                s.gpu_bytes ? fmt::format("{:.0f}", *s.gpu_bytes / kMebibyte) : "-", s.rate_hz, s.drops,
                                s.restarts ? std::to_string(*s.restarts) : "-", s.detail));
  }
  lines.emplace_back();
  lines.push_back(fmt::format("{:<24} {:>8} {:>10} {:>11} {:>11} {:>11} {:>11} {:>8}", "TOPIC", "HZ", "WIRE Mb/s",
                              "SHARED Mb/s", "TO BUS ms", "SINCE CAPT.", "GREATEST", "READERS"));
  for (const TopTopic& topic : view.topics) {
    const TopicTraffic& t = topic.traffic;
    lines.push_back(fmt::format("{:<24} {:>8.1f} {:>10.3f} {:>11.3f} {:>11} {:>11} {:>11} {:>8}", topic.name, t.rate_hz,
                                t.megabits_per_s, t.shared_megabits_per_s, in_ms(t.transits, t.transits.mean_s),
                                in_ms(t.ages, t.ages.mean_s), in_ms(t.ages, t.ages.greatest_s), topic.readers));
  }
  return lines;
}

Json to_json(const TopView& view) {
  Json json{{"bus", view.bus},
            {"interval_s", view.interval_s},
            {"services", Json::array()},
            {"topics", Json::array()},
            {"gpus", Json::array()}};
  for (const TopService& s : view.services) {
    json["services"].push_back({{"name", s.name},
                                {"pid", s.pid},
                                {"state", s.state},
                                {"backend", s.backend},
                                {"detail", s.detail},
                                {"restarts", or_null(s.restarts)},
                                {"processor_percent", or_null(s.processor_percent)},
                                {"own_memory_bytes", or_null(s.memory_bytes)},
                                {"gpu_bytes", or_null(s.gpu_bytes)},
                                {"rate_hz", s.rate_hz},
                                {"drops", s.drops}});
  }
  for (const TopTopic& topic : view.topics) {
    const TopicTraffic& t = topic.traffic;
    const bool aged = t.ages.count > 0;
    json["topics"].push_back({{"topic", topic.name},
                              {"rate_hz", t.rate_hz},
                              {"mbps", t.megabits_per_s},
                              {"shared_mbps", t.shared_megabits_per_s},
                              {"transit_s", t.transits.count > 0 ? Json(t.transits.mean_s) : Json(nullptr)},
                              {"age_s", aged ? Json(t.ages.mean_s) : Json(nullptr)},
                              {"greatest_age_s", aged ? Json(t.ages.greatest_s) : Json(nullptr)},
                              {"readers", topic.readers}});
  }
  for (const GpuUsage& gpu : view.gpus) {
    json["gpus"].push_back({{"name", gpu.name},
                            {"driver", gpu.driver},
                            {"busy_percent", gpu.busy_percent},
                            {"used_mib", gpu.used_mib},
                            {"total_mib", gpu.total_mib}});
  }
  return json;
}

}  // namespace splatbus::cli
