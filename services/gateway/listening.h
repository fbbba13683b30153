#pragma once

// Part of server.cpp: where it listens, and with which certificate.

#include <fmt/format.h>

#include <boost/asio/io_context.hpp>
#include <boost/asio/ssl/context.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bus/bind.h"
#include "bus/permanent_error.h"
#include "gateway/access.h"
#include "gateway/boost_types.h"
#include "gateway/parameters.h"

namespace splatbus::gateway {

/// What counts as one address for the limits.
inline std::string key_of(const asio::ip::address& address) {
  if (address.is_v4()) return address.to_string();
  const auto v6 = address.to_v6();
  if (v6.is_v4_mapped()) return asio::ip::make_address_v4(asio::ip::v4_mapped, v6).to_string();
  const auto bytes = v6.to_bytes();
  return {bytes.begin(), bytes.begin() + 8};
}

/// Nullopt where the options name no certificate. Throws bus::Error naming the file.
inline std::optional<asio::ssl::context> load_certificate(const Options& options) {
  if (options.certificate.empty()) return std::nullopt;
  asio::ssl::context tls(asio::ssl::context::tls_server);
  tls.set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_sslv3 |
                  asio::ssl::context::no_tlsv1 | asio::ssl::context::no_tlsv1_1);
  beast::error_code error;
  tls.use_certificate_chain_file(options.certificate, error);
  if (error) throw bus::PermanentError(fmt::format("certificate {}: {}", options.certificate, error.message()));
  tls.use_private_key_file(options.key, asio::ssl::context::pem, error);
  if (error) throw bus::PermanentError(fmt::format("key {}: {}", options.key, error.message()));
  return tls;
}

/// Of `http`; for localhost both addresses that it has, where the machine has both. Throws bus::Error naming it.
inline std::vector<asio::ip::tcp::acceptor> bind(asio::io_context& io, const std::string& http) {
  using asio::ip::tcp;
  const auto address = parse_host_port(http).value();
  std::vector<std::string> hosts{address.host};
  if (address.host == "localhost") hosts = {"127.0.0.1", "::1"};
  std::uint16_t port = address.port;
  std::vector<tcp::acceptor> acceptors;
  for (const std::string& host : hosts) {
    beast::error_code error;
    const auto ip = asio::ip::make_address(host, error);
    if (error) throw bus::PermanentError(fmt::format("http: '{}' is not an address of a network interface", host));
    const tcp::endpoint endpoint(ip, port);
    tcp::acceptor acceptor(io);
    const auto listen = [&] {
      acceptor = tcp::acceptor(io);
      acceptor.open(endpoint.protocol(), error);
      if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
      if (!error) acceptor.bind(endpoint, error);
      if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
      return error.value();
    };
    if (acceptors.empty()) {
      bus::bind_patiently("http " + http, listen);
    } else if (listen() != 0) {
      break;  // a machine without IPv6
    }
    port = acceptor.local_endpoint().port();
    acceptors.push_back(std::move(acceptor));
  }
  return acceptors;
}

/// As a person would type it.
inline std::string url_of(const std::string& http, std::uint16_t port, bool tls) {
  const std::string host = parse_host_port(http).value().host;
  const bool named = is_loopback(host) || host == "0.0.0.0" || host == "::";
  const std::string shown = named                                 ? "localhost"
                            : host.find(':') == std::string::npos ? host
                                                                  : fmt::format("[{}]", host);
  return fmt::format("{}://{}:{}", tls ? "https" : "http", shown, port);
}

}  // namespace splatbus::gateway
