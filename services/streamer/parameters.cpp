#include "streamer/parameters.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <string_view>
#include <utility>

#include "bus/error.h"

namespace splatbus::streamer {

namespace {

using stream::Attribute;

constexpr std::array<std::pair<Attribute, const char*>, 8> kScheduled{{{Attribute::Mean, "mean"},
                                                                       {Attribute::LogScale, "log_scale"},
                                                                       {Attribute::Rotation, "rotation"},
                                                                       {Attribute::Opacity, "opacity"},
                                                                       {Attribute::Albedo, "albedo"},
                                                                       {Attribute::Residual, "residual"},
                                                                       {Attribute::ShDc, "sh_dc"},
                                                                       {Attribute::ShRest, "sh_rest"}}};

}  // namespace

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  p.add("endpoint", endpoint, "ZeroMQ endpoint for viewers; empty: the streamer's name, in the bus's folder",
        bus::endpoint_rule(), kFixed);
  p.add("tcp", tcp,
        "second endpoint, for viewers on other machines, which need keys, such as tcp://*:7600; empty: none",
        bus::endpoint_rule(), kFixed);
  p.add(
      "tcp_address", tcp_address,
      "host, or host:port, by which others reach 'tcp'; empty: this machine's name where it is bound to all addresses",
      kFixed);
  p.add("drain_s", drain_s,
        "most time in which viewers move to another streamer when this one is told to end, if there is another; three "
        "quarters of the launch file's stop_timeout_s at most, s",
        {0, 60}, kFixed);
  p.add("key", keys.key, "key file for the tcp endpoint; empty: server.key of 'splatbus keys'", kFixed);
  p.add("allowed", keys.allowed, "file that lists who may connect over tcp; empty: that of 'splatbus keys'", kFixed);
  p.add("keys_on_loopback", keys.always, "require keys on the loopback address too", kFixed);
  p.add("tick_hz", hub.tick_hz, "updates per second", {0.1, 120}, kFixed);
  p.add("budget_kbps", budget_kbps,
        "rate for new Gaussians and changes of held pages, encoded once for all viewers, kbit/s", {10, 1e7});
  p.add("viewer_kbps", hub.viewer_kbps,
        "rate for one viewer, all but probe pictures, 100 or more; at most a tenth more in any second; 0: found from "
        "what arrives, kbit/s",
        {0, 1e7});
  p.add("join_kbps", hub.join_kbps,
        "rate for one viewer until it has had all that it is to have, where that is more than viewer_kbps; 0: none, "
        "kbit/s",
        {0, 1e7});
  p.add("visibility_hz", visibility_hz, "most updates per second of which Gaussians see the light", {0.1, 240});
  p.add("visibility_kbps", visibility_kbps,
        "rate for visibility, encoded once for all viewers; shadows lag when it is too low, kbit/s", {10, 1e7});
  p.add("coarseness", stream.coarseness, "extra rounding of what is small or faint, octaves; -20: none",
        {stream::Precision::kLossless, 10}, kFixed);
  p.add("calm_ticks", stream.calm_ticks, "ticks after which a resting value is sent to within one quantizer step",
        {1, 255}, kFixed);
  p.add("max_viewers", hub.max_viewers, "most viewers at a time", {1, 4096}, kFixed);
  p.add("max_viewers_per_address", hub.max_viewers_per_address,
        "most viewers at a time from one IPv4 address or IPv6 /64, or behind it at a gateway; not of this user's own "
        "processes",
        {1, 4096}, kFixed);
  p.add("viewer_timeout_s", hub.viewer_timeout_s,
        "time after which a viewer that neither sends nor reads is forgotten, s", {0.1, 3600}, kFixed);
  p.add("history_mb", hub.history_bytes, "memory for deltas kept for viewers that lag, MiB", {0, 1024}, kFixed,
        bus::kMebibytes);
  for (const auto& [attribute, name] : kScheduled) {
    stream::AttributeSchedule& s = stream.schedules[static_cast<std::size_t>(attribute)];
    p.add(fmt::format("{}_dead_zone", name), s.dead_zone,
          "largest change, in every channel, that is not sent while the value moves, quantizer steps", {0, 10000});
    p.add(fmt::format("{}_every", name), s.every, "ticks between deltas of it", {1, 1000});
  }
}

double drain_limit_s(double drain_s) {
  constexpr double kShare = 0.75;
  const char* const stop_timeout = std::getenv("SPLATBUS_STOP_TIMEOUT_S");
  if (stop_timeout == nullptr) return drain_s;
  return std::min(drain_s, kShare * std::strtod(stop_timeout, nullptr));
}

std::vector<std::string> endpoints(const Options& options, const bus::Address& address, const std::string& source) {
  std::vector<std::string> endpoints;
  if (!options.endpoint.empty()) {
    endpoints.push_back(options.endpoint);
  } else if (address.is_local()) {
    std::string name = source;
    std::ranges::replace(name, '/', '_');
    endpoints.push_back(fmt::format("ipc://{}/{}", *address.directory, name));
  }
  if (!options.tcp.empty()) endpoints.push_back(options.tcp);
  if (endpoints.empty()) {
    throw bus::Error(
        fmt::format("the bus at {} has no folder: set 'endpoint' or 'tcp' to where viewers connect", address.text()));
  }
  return endpoints;
}

std::vector<std::string> offered_endpoints(const Options& options, std::vector<std::string> bound) {
  constexpr std::string_view kTcp = "tcp://";
  for (std::string& endpoint : bound) {
    if (!endpoint.starts_with(kTcp)) continue;
    const std::size_t colon = endpoint.rfind(':');
    const std::string host = endpoint.substr(kTcp.size(), colon - kTcp.size());
    const bool everywhere = host == "0.0.0.0" || host == "[::]" || host == "*";
    if (!options.tcp_address.empty()) {
      const bool has_port = options.tcp_address.find(':') != std::string::npos;
      endpoint = fmt::format("{}{}{}", kTcp, options.tcp_address, has_port ? "" : endpoint.substr(colon));
    } else if (everywhere) {
      std::array<char, 256> name{};
      if (::gethostname(name.data(), name.size() - 1) == 0) {
        endpoint = fmt::format("{}{}{}", kTcp, name.data(), endpoint.substr(colon));
      }
    }
  }
  return bound;
}

}  // namespace splatbus::streamer
