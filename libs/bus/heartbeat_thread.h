#pragma once

#include <atomic>
#include <string>
#include <thread>

#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/token_bucket.h"
#include "wire/system_generated.h"

namespace splatbus::bus {

/// The thread beside a service's own: heartbeats, parameters changed through control/<kind> and control/<source>, and
/// what the service does, while sys/trace asks for it.
class HeartbeatThread {
 public:
  HeartbeatThread(ServiceContext& service, std::string kind);
  ~HeartbeatThread();
  HeartbeatThread(const HeartbeatThread&) = delete;
  HeartbeatThread& operator=(const HeartbeatThread&) = delete;

  /// Ends the thread and sends the last heartbeat. `reason` goes into its detail when not empty.
  void finish(wire::ServiceState state, const std::string& reason);

 private:
  void run(const std::stop_token& stop);
  void beat(wire::ServiceState state);
  [[nodiscard]] wire::ServiceState state() const;
  void obey(wire::Order order);
  void apply(const wire::Control& control, const Message& message);
  void publish_spans();

  ServiceContext& service_;
  const std::string kind_;
  Publisher publisher_;
  Subscriber control_;
  wire::ServiceState said_state_ = wire::ServiceState::Starting;  ///< in the last heartbeat
  TokenBucket said_{5, 50};                                       ///< log lines about changed parameters
  std::jthread thread_;
};

}  // namespace splatbus::bus
