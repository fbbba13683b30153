#pragma once

#include <functional>
#include <memory>
#include <stop_token>
#include <string>

#include "gateway/foxglove/hub.h"
#include "gateway/site.h"
#include "gateway/streamers.h"

namespace splatbus::gateway {

/// Listens, serves the site over HTTP, relays between browsers' WebSockets and streamers, moves them when one leaves,
/// and has clients of Foxglove's protocol speak with the hub. One thread.
class Server {
 public:
  /// Binds. Throws bus::Error naming the address, the certificate or the key, and what is wrong. The references outlive
  /// it.
  Server(const Options& options, Streamers& streamers, Site& site, PageLibrary& pages, ModelFiles& models,
         foxglove::Hub& hub, Traffic& traffic);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  /// Until `stop`; calls `tick` ten times a second.
  void run(const std::stop_token& stop, const std::function<void()>& tick);

  /// As bound, with its real port: "http://localhost:7680".
  [[nodiscard]] const std::string& url() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::gateway
