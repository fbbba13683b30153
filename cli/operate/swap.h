#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <string_view>

#include "bus/clock.h"
#include "bus/context.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

struct SwapLimits {
  double ready_s = 60;      ///< from a successor's start until it stands by
  double yield_s = 30;      ///< until the one before has left what is left
  double take_over_s = 60;  ///< until the successor runs in its place
};

/// A swap's way from one process to the next, without any process or bus: what is heard goes in, what is to be ordered
/// comes out. Until the successor stands by, the one before knows nothing of it. Times are CLOCK_MONOTONIC nanoseconds.
/// Not thread-safe.
class Swap {
 public:
  enum class Phase : std::uint8_t { GettingReady, Yielding, TakingOver, Done, Refused };

  struct Heartbeat {
    std::string source;
    pid_t pid = 0;
    wire::ServiceState state = wire::ServiceState::Starting;
    std::uint32_t protocol = 0;
    std::string detail;
  };
  struct Order {
    std::string source;  ///< of topic control/<source>
    pid_t pid = 0;
    wire::Order order = wire::Order::None;
  };

  Swap(std::string name, pid_t predecessor, pid_t successor, const SwapLimits& limits, std::int64_t now_ns);

  void hear(const Heartbeat& heartbeat, std::int64_t now_ns);
  /// `how`: "exited with status 1", and what it said last.
  void successor_ended(const std::string& how);
  void predecessor_ended(std::int64_t now_ns);
  /// Looks at the clock; the order to be published now, if any: again and again while it is not obeyed.
  [[nodiscard]] std::optional<Order> turn(std::int64_t now_ns);

  [[nodiscard]] Phase phase() const { return phase_; }
  [[nodiscard]] bool over() const { return phase_ == Phase::Done || phase_ == Phase::Refused; }
  [[nodiscard]] const std::string& refusal() const { return refusal_; }
  /// Of a refused one: the one before was told to leave already, and has to be started again.
  [[nodiscard]] bool has_yielded() const { return has_yielded_; }

 private:
  void enter(Phase phase, double limit_s, std::int64_t now_ns);
  void refuse(std::string why);

  const std::string name_;
  const pid_t predecessor_, successor_;
  const SwapLimits limits_;
  Phase phase_ = Phase::GettingReady;
  bool has_yielded_ = false, heard_ = false;
  std::string refusal_, detail_;  ///< detail_: of the successor's last heartbeat
  std::int64_t deadline_ns_ = 0, next_order_ns_ = 0;
};

/// Who has the processes: a supervisor, or a test.
class SwapHost {
 public:
  virtual ~SwapHost() = default;
  SwapHost(const SwapHost&) = delete;
  SwapHost& operator=(const SwapHost&) = delete;

  [[nodiscard]] virtual pid_t predecessor() const = 0;
  /// With --successor. Throws std::runtime_error.
  [[nodiscard]] virtual pid_t start_successor() = 0;
  /// How it ended, in words; nothing while it runs.
  [[nodiscard]] virtual std::optional<std::string> successor_end() = 0;
  [[nodiscard]] virtual bool predecessor_ended() = 0;
  /// The successor is the service's process from now on; the one before leaves, or is made to.
  virtual void exchange() = 0;
  virtual void drop_successor() = 0;
  /// As it was before.
  virtual void restart_predecessor() = 0;

 protected:
  SwapHost() = default;
};

/// Swaps a service's process for the host's successor; returns when that runs in its place. `tell` hears of each phase.
/// Throws std::runtime_error with the reason when it is refused: then the service goes on as it was.
void run_swap(SwapHost& host, const std::shared_ptr<bus::Context>& bus, const std::string& name,
              const SwapLimits& limits, const std::function<void(const std::string&)>& tell,
              const std::stop_token& stop);

}  // namespace splatbus::cli
