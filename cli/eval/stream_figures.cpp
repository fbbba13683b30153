#include "stream_figures.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "figures.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

constexpr double kMegabit_bytes = 1e6 / 8;

double time_s(const Arrival& arrival, std::int64_t begin_ns) {
  return static_cast<double>(arrival.at_ns - begin_ns) / 1e9;
}

Json or_null(const std::optional<double>& value) {
  return value ? Json(rounded(*value)) : Json();
}

std::optional<double> mean(const std::vector<double>& values) {
  if (values.empty()) return {};
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

template <class Get>
std::vector<double> server_figures(const StreamResults& results, const TimeWindow& window, Get get) {
  std::vector<double> values;
  for (const ServerSample& sample : results.server) {
    if (window.contains(sample.time_s)) values.push_back(get(sample));
  }
  return values;
}

Json summarize_stage(const StreamResults& results, const ViewersStage& stage) {
  const TimeWindow window{.from_s = stage.from_s, .to_s = stage.to_s};
  const auto at_server = [&](auto member) {
    return or_null(median(server_figures(results, window, [=](const ServerSample& sample) { return sample.*member; })));
  };
  return {{"viewers", stage.viewers},
          {"whole", stage.whole},
          {"tick_ms", at_server(&ServerSample::tick_ms)},
          {"cpu_share", at_server(&ServerSample::cpu_share)},
          {"resident_mb", at_server(&ServerSample::resident_mb)},
          {"mbps_mean", or_null(mean(total_of(megabits_by_second(results.arrivals, results.begin_ns, window))))}};
}

/// Each further viewer's share of the streamer's memory, from the first stage to the last.
Json memory_a_viewer(const Json& stages) {
  const Json &first = stages.front(), &last = stages.back();
  const double more = last["viewers"].get<double>() - first["viewers"].get<double>();
  if (more <= 0 || !first["resident_mb"].is_number() || !last["resident_mb"].is_number()) return nullptr;
  return rounded((last["resident_mb"].get<double>() - first["resident_mb"].get<double>()) / more);
}

}  // namespace

BitsBySecond megabits_by_second(std::span<const Arrival> arrivals, std::int64_t begin_ns, const TimeWindow& window) {
  const double length_s = std::floor(window.to_s - window.from_s);
  BitsBySecond bits;
  if (length_s < 1) return bits;
  for (const Arrival& arrival : arrivals) {
    const double second = std::floor(time_s(arrival, begin_ns) - window.from_s);
    if (second < 0 || second >= length_s) continue;
    std::vector<double>& seconds = bits[arrival.body];
    seconds.resize(static_cast<std::size_t>(length_s));
    seconds[static_cast<std::size_t>(second)] += static_cast<double>(arrival.bytes) / kMegabit_bytes;
  }
  return bits;
}

std::vector<double> total_of(const BitsBySecond& bits) {
  std::vector<double> total;
  for (const auto& [body, seconds] : bits) {
    total.resize(seconds.size());
    for (std::size_t i = 0; i < seconds.size(); ++i) total[i] += seconds[i];
  }
  return total;
}

double peak_megabits(std::span<const Arrival> arrivals, std::int64_t begin_ns, const TimeWindow& window) {
  double most = 0, bytes = 0;
  std::size_t first = 0;
  for (std::size_t last = 0; last < arrivals.size(); ++last) {
    const double until_s = time_s(arrivals[last], begin_ns);
    if (!window.contains(until_s)) {
      bytes = 0;
      first = last + 1;
      continue;
    }
    bytes += static_cast<double>(arrivals[last].bytes);
    while (arrivals[last].at_ns - arrivals[first].at_ns >= 1'000'000'000) {
      bytes -= static_cast<double>(arrivals[first++].bytes);
    }
    most = std::max(most, bytes);
  }
  return most / kMegabit_bytes;
}

std::optional<double> median(std::vector<double> values) {
  if (values.empty()) return {};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  if (values.size() % 2 == 1) return *middle;
  return (*middle + *std::max_element(values.begin(), middle)) / 2;
}

Json summarize_stream(const StreamResults& results) {
  const TimeWindow judged{.from_s = results.whole_s.value_or(results.end_s / 2), .to_s = results.end_s};
  const BitsBySecond bits = megabits_by_second(results.arrivals, results.begin_ns, judged);
  const std::vector<double> seconds = total_of(bits);
  Json by_type = Json::object();
  for (const auto& [body, megabits] : bits) by_type[wire::EnumNameBody(body)] = or_null(mean(megabits));
  std::vector<double> server, viewer;
  std::optional<double> gap_worst;
  for (const StreamSample& sample : results.samples) {
    if (!judged.contains(sample.time_s)) continue;
    server.push_back(sample.ssim_server);
    viewer.push_back(sample.ssim_viewer);
    gap_worst = std::max(gap_worst.value_or(sample.gap()), sample.gap());
  }
  const auto tick_ms =
      median(server_figures(results, judged, [](const ServerSample& sample) { return sample.tick_ms; }));
  std::vector<double> deliveries_ms;
  for (const Delivery& delivery : results.deliveries) {
    if (delivery.whole || !judged.contains(static_cast<double>(delivery.there_ns - results.begin_ns) / 1e9)) continue;
    deliveries_ms.push_back(static_cast<double>(delivery.there_ns - delivery.encoded_ns) / 1e6);
  }
  const auto delivery_ms = median(std::move(deliveries_ms));
  const std::optional<double> wait_ms = results.tick_hz > 0 ? std::optional(500 / results.tick_hz) : std::nullopt;
  const std::optional<double> latency_ms =
      tick_ms && delivery_ms && wait_ms ? std::optional(*wait_ms + *tick_ms + *delivery_ms) : std::nullopt;
  Json summary{{"link", results.link},
               {"gaussians", results.gaussians},
               {"mbps_mean", or_null(mean(seconds))},
               {"mbps_median", or_null(median(seconds))},
               {"mbps_peak",
                seconds.empty() ? Json() : Json(rounded(peak_megabits(results.arrivals, results.begin_ns, judged)))},
               {"mbps_by_type", std::move(by_type)},
               {"ssim_server", or_null(mean(server))},
               {"ssim_viewer", or_null(mean(viewer))},
               {"ssim_gap_worst", or_null(gap_worst)},
               {"samples", server.size()},
               {"join_first_s", or_null(results.join.first_s)},
               {"join_near_s", or_null(results.join.near_s)},
               {"join_close_s", or_null(results.join.close_s)},
               {"join_whole_s", or_null(results.join.whole_s)},
               {"latency_ms", or_null(latency_ms)},
               {"latency_wait_ms", or_null(wait_ms)},
               {"latency_tick_ms", or_null(tick_ms)},
               {"latency_delivery_ms", or_null(delivery_ms)},
               {"first_whole_s", or_null(results.whole_s)},
               {"judged_s", rounded(judged.to_s - judged.from_s)},
               {"refused_packets", results.refused}};
  if (results.mbps > 0) summary["link_mbps"] = results.mbps;
  if (results.cut) {
    summary["cut_s"] = rounded(results.cut->to_s - results.cut->from_s);
    summary["cut_fresh_s"] = or_null(results.cut_fresh_s);
    summary["cut_whole_s"] = or_null(results.cut_whole_s);
  }
  if (!results.stages.empty()) {
    Json stages = Json::array();
    for (const ViewersStage& stage : results.stages) stages.push_back(summarize_stage(results, stage));
    summary["resident_mb_a_viewer"] = memory_a_viewer(stages);
    summary["stages"] = std::move(stages);
  }
  return summary;
}

}  // namespace splatbus::cli
