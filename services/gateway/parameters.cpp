#include "gateway/parameters.h"

#include <fmt/format.h>

#include <filesystem>

#include "bus/error.h"
#include "gateway/access.h"

namespace splatbus::gateway {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  p.add("endpoint", endpoint, "ZeroMQ endpoint of one streamer for all; empty: those on the bus share the browsers",
        bus::endpoint_rule(), kFixed);
  p.add("http", http,
        "address and port to listen on; beyond this machine it needs 'tokens', and a certificate or 'insecure'",
        kFixed);
  p.add("certificate", certificate, "PEM file with the certificate chain; with 'key', serve https and wss", kFixed);
  p.add("key", key, "PEM file with the certificate's private key", kFixed);
  p.add("insecure", insecure,
        "allow plain http beyond this machine, where anybody on the way can read and change everything", kFixed);
  p.add("tokens", tokens, "file with a role and the SHA-256 of a token on each line; empty: anybody may do anything",
        kFixed);
  p.add("origins", origins,
        "other web origins whose pages may connect, such as https://example.org, separated by commas", kFixed);
  p.add("web_root", web_root, "folder with the page; empty: share/splatbus/web beside the program's folder", kFixed);
  p.add("mip", mip,
        "whether the model was trained with Mip-Splatting's filter, as ours are: what the page draws it with, and "
        "files of "
        "it are marked with",
        kFixed);
  p.add("shared_caches", shared_caches,
        "with 'tokens': let shared caches, such as a CDN's, keep frozen pages and decide who gets them", kFixed);
  p.add("page_cache_mb", page_cache_bytes, "memory for frozen pages that are served again, MiB", {1, 65536}, kFixed,
        bus::kMebibytes);
  p.add("max_model_gaussians", max_model_gaussians,
        "largest model offered as a file, which needs a copy in memory, in Gaussians; 0: offer none", {0, 1e9}, kFixed);
  p.add("max_connections", limits.connections, "most connections at a time", {1, 16384}, kFixed);
  p.add("max_connections_per_address", limits.connections_per_address,
        "most connections at a time from one IPv4 address or IPv6 /64; behind a proxy all share one", {1, 16384},
        kFixed);
  p.add("max_message_bytes", limits.message_bytes, "largest WebSocket message from a browser, bytes", {64, 1 << 20},
        kFixed);
  p.add("max_rate_kbps", limits.rate_kbps, "most data read from one connection, kbit/s", {8, 1e6}, kFixed);
  p.add("max_messages_per_s", limits.messages_per_s, "most messages per second read from one browser", {1, 10000},
        kFixed);
  p.add("max_total_rate_kbps", limits.total_rate_kbps,
        "most data read from all connections together, kbit/s; the busiest wait first", {8, 1e8}, kFixed);
  p.add("max_total_messages_per_s", limits.total_messages_per_s,
        "most messages and requests per second of all connections together; the busiest wait first", {1, 1e7}, kFixed);
  p.add("max_queued_mb", limits.queued_bytes,
        "memory for packets being written to browsers; beyond, the slowest browser is disconnected, MiB", {8, 16384},
        kFixed, bus::kMebibytes);
  p.add("handshake_s", limits.handshake_s, "longest TLS handshake or request header, s", {0.1, 60}, kFixed);
  p.add("idle_s", limits.idle_s, "time without a request or a browser's pong after which a connection is closed, s",
        {0.2, 3600}, kFixed);
  p.add("stall_s", limits.stall_s, "time without progress in writing after which a connection is closed, s",
        {0.2, 3600}, kFixed);
  p.add("max_foxglove_clients", foxglove.clients, "clients of Foxglove's protocol at a time; 0: none", {0, 256},
        kFixed);
  p.add("foxglove_queue_mb", foxglove.queue_bytes,
        "MB of messages that wait for one such client; above that the oldest are left out", {1, 1024}, kFixed,
        bus::kMebibytes);
  p.add("foxglove_pictures_hz", foxglove.pictures_hz, "rate of pictures of each camera for such clients, Hz",
        {0.01, 60}, kFixed);
  p.add("foxglove_pictures", foxglove.png, "how such clients get colour pictures: jpeg, or png, which loses nothing",
        {{"jpeg", false}, {"png", true}}, kFixed);
  p.add("foxglove_points", foxglove.points, "most Gaussians shown in a point cloud", {1, 5e6}, kFixed);
  p.add("foxglove_points_hz", foxglove.points_hz, "rate of point clouds, Hz", {0.01, 10}, kFixed);
}

void check(const Options& options) {
  const auto address = parse_host_port(options.http);
  if (!address)
    throw bus::Error(fmt::format("http: '{}' is not an address and port, such as 127.0.0.1:7680", options.http));
  if (options.certificate.empty() != options.key.empty()) {
    throw bus::Error("'certificate' and 'key' go together: set both or neither");
  }
  if (is_loopback(address->host)) return;
  if (options.tokens.empty()) {
    throw bus::Error(fmt::format("http: {} can be reached from other machines: set 'tokens'", options.http));
  }
  if (options.certificate.empty() && !options.insecure) {
    throw bus::Error(fmt::format(
        "http: {} can be reached from other machines: set 'certificate' and 'key', or insecure=true", options.http));
  }
}

std::string streamer_endpoint(const Options& options, const bus::Address& address) {
  if (!options.endpoint.empty()) return options.endpoint;
  if (!address.is_local()) return {};
  return "ipc://" + *address.directory + "/streamer";
}

std::string web_root(const Options& options) {
  if (!options.web_root.empty()) return options.web_root;
  const auto program = std::filesystem::read_symlink("/proc/self/exe");
  return (program.parent_path().parent_path() / "share/splatbus/web").string();
}

}  // namespace splatbus::gateway
