#pragma once

#include <memory>
#include <thread>

#include "gateway/foxglove/feed.h"
#include "gateway/foxglove/hub.h"

namespace splatbus::gateway::foxglove {

/// What clients of Foxglove's protocol are served from: the hub, and the thread that fills it from the bus. Outlives
/// the server; `options` outlive it.
class Service {
 public:
  Service(std::shared_ptr<bus::Context> context, const Options& options);
  Service(const Service&) = delete;
  Service& operator=(const Service&) = delete;

  [[nodiscard]] Hub& hub() { return hub_; }

 private:
  Hub hub_;
  Feed feed_;
  std::jthread thread_;
};

}  // namespace splatbus::gateway::foxglove
