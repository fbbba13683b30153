#pragma once

#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/curve.h"
#include "bus/parameters.h"
#include "stream/stream_model.h"
#include "streamer/viewer_hub.h"

namespace splatbus::streamer {

/// The streamer's parameters.
struct Options {
  /// The models of docs/benchmarks.md have 50 dB with it.
  static constexpr float kCoarseness = 0.25F;

  std::string endpoint, tcp, tcp_address;
  bus::ServerKeyFiles keys;
  double budget_kbps = 6000;
  double visibility_hz = 20, visibility_kbps = 1000;
  double drain_s = 3;  ///< at the end, at most: until its viewers are with another streamer
  HubOptions hub;
  stream::StreamOptions stream{.coarseness = kCoarseness};

  void bind(bus::ParameterBinder& parameters);
};

/// How long a streamer may drain that whoever started it kills SPLATBUS_STOP_TIMEOUT_S after SIGTERM: `drain_s`, and no
/// more than leaves it a quarter of that time to end in.
[[nodiscard]] double drain_limit_s(double drain_s);

/// Where to bind: `endpoint` (empty: ipc, `source` in the bus's folder, when the bus is local) and `tcp`. Throws
/// bus::Error when that is nowhere.
[[nodiscard]] std::vector<std::string> endpoints(const Options& options, const bus::Address& address,
                                                 const std::string& source);

/// As gateways and viewers are told of them: `bound`, with tcp_address in place of what is bound to all addresses, or
/// this machine's name.
[[nodiscard]] std::vector<std::string> offered_endpoints(const Options& options, std::vector<std::string> bound);

}  // namespace splatbus::streamer
