#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "launch_file.h"

namespace splatbus::cli {

/// Where browsers find the pipeline of a launch file.
struct GatewayUrl {
  std::string url;
  bool elsewhere = false;  ///< the usual port is taken
};

inline constexpr std::uint16_t kGatewayPort = 7680;

/// Gives the file's gateway an address where it has none: loopback, `port` where that is free, else another free one.
/// The choice is made here and not by the gateway, so that it is the same whenever that is restarted. Nullopt when the
/// file has no gateway.
std::optional<GatewayUrl> settle_gateway(LaunchFile& file, std::uint16_t port = kGatewayPort);

/// "open http://localhost:7680 in a browser", or with a word on why it is another port.
[[nodiscard]] std::string invitation(const GatewayUrl& gateway);

}  // namespace splatbus::cli
