#include "streamer/parameters.h"

#include <fmt/format.h>

#include <array>
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

std::vector<bus::ParameterSpec> parameter_specs() {
  std::vector<bus::ParameterSpec> specs{
      {.name = "endpoint",
       .default_value = std::string(),
       .description = "ZeroMQ endpoint for viewers; empty: ipc, 'streamer' in the folder of the bus",
       .runtime = false},
      {.name = "tcp",
       .default_value = std::string(),
       .description = "another endpoint, for viewers elsewhere, such as tcp://127.0.0.1:7600; empty: none",
       .runtime = false},
      {.name = "tick_hz",
       .default_value = 5.0,
       .description = "updates a second",
       .minimum = 0.1,
       .maximum = 120,
       .runtime = false},
      {.name = "budget_kbps",
       .default_value = 6000.0,
       .description = "kbit/s to one viewer for new Gaussians and deltas; snapshots of those who join come on top",
       .minimum = 10,
       .maximum = 1e7},
      {.name = "calm_ticks",
       .default_value = std::int64_t{8},
       .description = "ticks after which a value that rests is sent to within a step of its quantiser",
       .minimum = 1,
       .maximum = 255,
       .runtime = false},
      {.name = "chunk_gaussians",
       .default_value = std::int64_t{4096},
       .description = "Gaussians in one packet of a snapshot, at most",
       .minimum = 64,
       .maximum = static_cast<double>(stream::kMaxChunkGaussians),
       .runtime = false},
      {.name = "max_viewers",
       .default_value = std::int64_t{64},
       .description = "that are served",
       .minimum = 1,
       .maximum = 4096,
       .runtime = false},
      {.name = "viewer_timeout_s",
       .default_value = 5.0,
       .description = "seconds after which a viewer that sends or reads nothing is forgotten",
       .minimum = 0.1,
       .maximum = 3600,
       .runtime = false},
      {.name = "history_mb",
       .default_value = std::int64_t{16},
       .description = "MB of sent packets kept for viewers that lost some",
       .minimum = 0,
       .maximum = 1024,
       .runtime = false},
  };
  const stream::Schedules defaults = stream::default_schedules();
  for (const auto& [attribute, name] : kScheduled) {
    const stream::AttributeSchedule& s = defaults[static_cast<std::size_t>(attribute)];
    specs.push_back(
        {.name = fmt::format("{}_dead_zone", name),
         .default_value = std::int64_t{s.dead_zone},
         .description =
             "quantiser steps; a change up to that, in every channel, is not sent while the value still moves",
         .minimum = 0,
         .maximum = 10000});
    specs.push_back({.name = fmt::format("{}_every", name),
                     .default_value = std::int64_t{s.every},
                     .description = "ticks between its deltas",
                     .minimum = 1,
                     .maximum = 1000});
  }
  return specs;
}

std::vector<std::string> endpoints(const bus::Parameters& parameters, const bus::Address& address) {
  std::vector<std::string> endpoints;
  if (const std::string endpoint = parameters.text("endpoint"); !endpoint.empty()) {
    endpoints.push_back(endpoint);
  } else if (address.is_local()) {
    endpoints.push_back("ipc://" + *address.directory + "/streamer");
  }
  if (const std::string tcp = parameters.text("tcp"); !tcp.empty()) endpoints.push_back(tcp);
  if (endpoints.empty()) {
    throw bus::Error(
        fmt::format("the bus at {} has no folder: set 'endpoint' or 'tcp' to where viewers connect", address.text()));
  }
  return endpoints;
}

stream::Schedules schedules(const bus::Parameters& parameters) {
  stream::Schedules schedules = stream::default_schedules();
  for (const auto& [attribute, name] : kScheduled) {
    stream::AttributeSchedule& s = schedules[static_cast<std::size_t>(attribute)];
    s.dead_zone = static_cast<std::int32_t>(parameters.integer(fmt::format("{}_dead_zone", name)));
    s.every = static_cast<std::uint32_t>(parameters.integer(fmt::format("{}_every", name)));
  }
  return schedules;
}

}  // namespace splatbus::streamer
