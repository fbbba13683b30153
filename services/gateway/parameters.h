#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "bus/context.h"
#include "bus/parameters.h"

namespace splatbus::gateway {

/// The bounds that every connection is held to.
struct Limits {
  int connections = 512;
  int connections_per_address = 128;
  std::size_t message_bytes = 65536;     ///< of one WebSocket message from a browser
  double rate_kbps = 2000;               ///< kbit/s from one connection; what is beyond that is not read until later
  double messages_per_s = 240;           ///< from one browser
  double total_rate_kbps = 200'000;      ///< kbit/s from all connections together; then the busiest wait first
  double total_messages_per_s = 20'000;  ///< the same
  std::size_t queued_bytes = std::size_t{256} << 20;  ///< of packets that are being written, all browsers together
  double handshake_s = 5;                             ///< for TLS, and for the header of a request
  double idle_s = 30;                                 ///< without a request or, from a browser, so much as a pong
  double stall_s = 10;                                ///< in which a browser that is being written to takes no byte
};

/// For Foxglove and other clients of its protocol.
struct FoxgloveOptions {
  int clients = 16;                                 ///< at a time; 0: none
  std::size_t queue_bytes = std::size_t{16} << 20;  ///< of messages that wait for one client
  double pictures_hz = 5;                           ///< of one camera
  bool png = false;                                 ///< pictures without loss, and larger, instead of JPEG
  std::size_t points = 200'000;                     ///< of the model's Gaussians in a cloud
  double points_hz = 1;
};

/// The gateway's parameters.
struct Options {
  std::string endpoint;
  std::string http = "127.0.0.1:7680";
  std::string certificate, key, tokens, origins, web_root;
  bool insecure = false, shared_caches = false;
  bool mip = true;  ///< the model is trained with the filter that RenderOptions::antialias stands for
  std::size_t page_cache_bytes = std::size_t{64} << 20;  ///< of frozen pages that are kept to be served again
  std::size_t max_model_gaussians = 4'000'000;           ///< of a model that is given away as a file; 0: none is
  Limits limits;
  FoxgloveOptions foxglove;

  void bind(bus::ParameterBinder& parameters);
};

/// Throws bus::Error in words where the options do not go together: an address beyond this machine needs `tokens`, and
/// `certificate` and `key` or `insecure`.
void check(const Options& options);

/// The streamer's place before the bus has named one: `endpoint`, or ipc, "streamer" in the bus's folder; empty where
/// the bus has no folder.
[[nodiscard]] std::string streamer_endpoint(const Options& options, const bus::Address& address);

/// `web_root`, or share/splatbus/web beside the program's folder.
[[nodiscard]] std::string web_root(const Options& options);

}  // namespace splatbus::gateway
