#include "streamer/parameters.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <array>
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
  p.add("endpoint", endpoint, "ZeroMQ endpoint for viewers; empty: ipc, the streamer's name in the folder of the bus",
        kFixed);
  p.add("tcp", tcp, "another endpoint, for viewers elsewhere, such as tcp://*:7600, where they need keys; empty: none",
        kFixed);
  p.add(
      "tcp_address", tcp_address,
      "host, or host:port, by which others reach 'tcp'; empty: this machine's name where it is bound to all addresses",
      kFixed);
  p.add("drain_s", drain_s,
        "seconds in which its viewers move to another streamer when it is told to end, if there is another", {0, 60},
        kFixed);
  p.add("key", keys.key, "file of this end's key for a tcp endpoint; empty: server.key of 'splatbus keys'", kFixed);
  p.add("allowed", keys.allowed, "file with who may connect there; empty: that of 'splatbus keys'", kFixed);
  p.add("keys_on_loopback", keys.always, "a tcp endpoint takes keys on the loopback address too", kFixed);
  p.add("tick_hz", hub.tick_hz, "updates a second", {0.1, 120}, kFixed);
  p.add("budget_kbps", budget_kbps,
        "kbit/s for new Gaussians and deltas of pages that are held, encoded once for all viewers", {10, 1e7});
  p.add("viewer_kbps", hub.viewer_kbps,
        "kbit/s to one viewer, of everything but probe pictures; no second has more than a tenth above it. 0: found "
        "out from what arrives",
        {0, 1e7});
  p.add("visibility_hz", visibility_hz, "updates a second, at most, of which Gaussians see the sun", {0.1, 240});
  p.add("visibility_kbps", visibility_kbps,
        "kbit/s for these, encoded once for all viewers; shadows lag where it is too low", {10, 1e7});
  p.add("coarseness", stream.coarseness,
        "octaves; values of what is small or faint are rounded so much more, a bit for each. -20: none is",
        {stream::Precision::kLossless, 10}, kFixed);
  p.add("calm_ticks", stream.calm_ticks,
        "ticks after which a value that rests is sent to within a step of its quantizer", {1, 255}, kFixed);
  p.add("max_viewers", hub.max_viewers, "that are served", {1, 4096}, kFixed);
  p.add("viewer_timeout_s", hub.viewer_timeout_s,
        "seconds after which a viewer that sends or reads nothing is forgotten", {0.1, 3600}, kFixed);
  p.add("history_mb", hub.history_bytes, "MB of deltas kept for viewers that are behind", {0, 1024}, kFixed,
        bus::kMebibytes);
  for (const auto& [attribute, name] : kScheduled) {
    stream::AttributeSchedule& s = stream.schedules[static_cast<std::size_t>(attribute)];
    p.add(fmt::format("{}_dead_zone", name), s.dead_zone,
          "quantizer steps; a change up to that, in every channel, is not sent while the value still moves",
          {0, 10000});
    p.add(fmt::format("{}_every", name), s.every, "ticks between its deltas", {1, 1000});
  }
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
