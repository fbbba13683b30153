#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "bus/log_sink.h"
#include "bus/subscriber.h"
#include "stream/streamer_choice.h"

namespace splatbus::gateway {

/// Which streamer serves whom: one that is named for good, or those that the bus knows, the least loaded first. One
/// thread.
class Streamers {
 public:
  /// Everybody goes to that endpoint.
  explicit Streamers(std::string endpoint) : fixed_({"", std::move(endpoint)}) {}
  /// Those on the bus. Before any is known, and where none is, it is `fallback`; empty: nobody is served then.
  Streamers(const std::shared_ptr<bus::Context>& context, std::string fallback);

  /// Takes what has come on the bus. Never waits.
  void poll(std::int64_t now_ns);

  /// For somebody new.
  [[nodiscard]] stream::StreamerPlace choose(std::int64_t now_ns);
  /// Where somebody at `place` has to go, since nobody serves there any more; nullopt: it stays.
  [[nodiscard]] std::optional<stream::StreamerPlace> instead_of(const stream::StreamerPlace& place,
                                                                std::int64_t now_ns);
  /// Where somebody at `place` would do better, since far fewer are there; nullopt: it stays.
  [[nodiscard]] std::optional<stream::StreamerPlace> better_than(const stream::StreamerPlace& place,
                                                                 std::int64_t now_ns);
  /// That place cannot be connected to: for a while nobody is sent there. False where there is no other to choose.
  bool pass_over(const stream::StreamerPlace& place, const std::string& why, std::int64_t now_ns);

 private:
  struct OnBus {
    OnBus(const std::shared_ptr<bus::Context>& context, bool local) : choice(local), subscriber(context) {
      stream::follow_offers(subscriber, choice, now_ns);
    }
    std::int64_t now_ns = 0;
    stream::StreamerChoice choice;
    bus::Subscriber subscriber;
  };
  stream::StreamerPlace fixed_;
  std::unique_ptr<OnBus> on_bus_;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::gateway
