#include "swap.h"

#include <fmt/format.h>

#include <stdexcept>
#include <utility>

#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kOrderPeriodNs = 300'000'000;
constexpr std::chrono::milliseconds kTurn{20};

std::string with_detail(std::string text, const std::string& detail) {
  return detail.empty() ? text : fmt::format("{}: {}", text, detail);
}

const char* words_of(Swap::Phase phase) {
  switch (phase) {
    case Swap::Phase::GettingReady:
      return "the successor gets ready";
    case Swap::Phase::Yielding:
      return "the successor is ready; the process before hands over";
    case Swap::Phase::TakingOver:
      return "the successor takes over";
    case Swap::Phase::Done:
      return "the successor runs";
    case Swap::Phase::Refused:
      return "refused";
  }
  return "?";
}

/// Until the swap is done or refused, or `stop` is asked for.
void follow(Swap& swap, SwapHost& host, bus::Subscriber& heartbeats, const bus::Publisher& publisher,
            const std::function<void(const std::string&)>& tell, const std::stop_token& stop) {
  heartbeats.on(topics::kHeartbeat, [&](const wire::Heartbeat& heard, const bus::Message& message) {
    swap.hear({.source = message.header().source()->str(),
               .pid = static_cast<pid_t>(heard.pid()),
               .state = heard.state(),
               .protocol = heard.protocol(),
               .detail = heard.detail() != nullptr ? heard.detail()->str() : ""},
              bus::now_ns());
  });
  std::optional<Swap::Phase> told;
  while (!swap.over() && !stop.stop_requested()) {
    if (told != swap.phase()) tell(words_of(*(told = swap.phase())));
    heartbeats.dispatch_all(kTurn);
    if (const auto how = host.successor_end()) swap.successor_ended(*how);
    if (host.predecessor_ended()) swap.predecessor_ended(bus::now_ns());
    const auto order = swap.turn(bus::now_ns());
    if (!order) continue;
    const std::string topic = "control/" + order->source;
    publisher.publish(topics::control(topic), [&](auto& builder, auto header) {
      return wire::CreateControl(builder, header, 0, order->order, static_cast<std::uint32_t>(order->pid));
    });
  }
}

}  // namespace

Swap::Swap(std::string name, pid_t predecessor, pid_t successor, const SwapLimits& limits, std::int64_t now_ns)
    : name_(std::move(name)), predecessor_(predecessor), successor_(successor), limits_(limits) {
  enter(Phase::GettingReady, limits.ready_s, now_ns);
}

void Swap::enter(Phase phase, double limit_s, std::int64_t now_ns) {
  phase_ = phase;
  deadline_ns_ = now_ns + static_cast<std::int64_t>(limit_s * 1e9);
  next_order_ns_ = now_ns;
}

void Swap::refuse(std::string why) {
  phase_ = Phase::Refused;
  refusal_ = std::move(why);
}

void Swap::hear(const Heartbeat& heartbeat, std::int64_t now_ns) {
  if (over()) return;
  using State = wire::ServiceState;
  if (heartbeat.pid == predecessor_ && heartbeat.source == name_) {
    const bool leaves = heartbeat.state == State::Stopping || heartbeat.state == State::Failed;
    if (leaves) predecessor_ended(now_ns);
    return;
  }
  if (heartbeat.pid != successor_) return;
  heard_ = true;
  detail_ = heartbeat.detail;
  if (heartbeat.protocol != kProtocolVersion) {
    return refuse(fmt::format("the successor speaks version {} of the protocol, this bus version {}",
                              heartbeat.protocol, kProtocolVersion));
  }
  if (heartbeat.state == State::Failed) return refuse(with_detail("the successor failed", detail_));
  if (heartbeat.source == bus::successor_name(name_)) {
    if (phase_ == Phase::GettingReady && heartbeat.state == State::Standby) {
      enter(Phase::Yielding, limits_.yield_s, now_ns);
    }
  } else if (heartbeat.source == name_ && phase_ == Phase::TakingOver && heartbeat.state == State::Running) {
    phase_ = Phase::Done;
  }
}

void Swap::successor_ended(const std::string& how) {
  if (over()) return;
  const char* const when = phase_ == Phase::GettingReady ? "before it was ready" : "while it took over";
  refuse(fmt::format("the successor ended {}: {}", when, how));
}

void Swap::predecessor_ended(std::int64_t now_ns) {
  if (phase_ == Phase::GettingReady) return refuse(fmt::format("{} ended before its successor was ready", name_));
  if (phase_ == Phase::Yielding) enter(Phase::TakingOver, limits_.take_over_s, now_ns);
}

std::optional<Swap::Order> Swap::turn(std::int64_t now_ns) {
  if (over()) return std::nullopt;
  if (now_ns >= deadline_ns_) {
    if (phase_ == Phase::GettingReady) {
      refuse(heard_ ? with_detail(fmt::format("the successor was not ready within {:g} s", limits_.ready_s), detail_)
                    : fmt::format("the successor sent no heartbeat within {:g} s", limits_.ready_s));
    } else if (phase_ == Phase::Yielding) {
      refuse(fmt::format("{} did not hand over within {:.3g} s", name_, limits_.yield_s));
    } else {
      refuse(with_detail(fmt::format("the successor did not take over within {:.3g} s", limits_.take_over_s), detail_));
    }
    return std::nullopt;
  }
  if (phase_ == Phase::GettingReady || now_ns < next_order_ns_) return std::nullopt;
  next_order_ns_ = now_ns + kOrderPeriodNs;
  has_yielded_ = true;
  if (phase_ == Phase::Yielding) return Order{name_, predecessor_, wire::Order::Yield};
  return Order{bus::successor_name(name_), successor_, wire::Order::TakeOver};
}

void run_swap(SwapHost& host, const std::shared_ptr<bus::Context>& bus, const std::string& name,
              const SwapLimits& limits, const std::function<void(const std::string&)>& tell,
              const std::stop_token& stop) {
  bus::Subscriber heartbeats(bus);
  const bus::Publisher publisher(bus);
  const pid_t predecessor = host.predecessor(), successor = host.start_successor();
  Swap swap(name, predecessor, successor, limits, bus::now_ns());
  std::string why;
  bool done = false;
  try {
    follow(swap, host, heartbeats, publisher, tell, stop);
    why = swap.over() ? swap.refusal() : "interrupted";
    if (swap.phase() == Swap::Phase::Done) {
      host.exchange();
      done = true;
    }
  } catch (const std::exception& error) {
    why = error.what();  // a successor that stayed would have every later order refused
  }
  if (done) {
    tell(words_of(Swap::Phase::Done));
    return;
  }
  host.drop_successor();
  if (swap.has_yielded()) host.restart_predecessor();
  throw std::runtime_error(fmt::format("{}{}", why,
                                       swap.has_yielded() ? fmt::format("; {} was started again as it was", name)
                                                          : fmt::format("; {} goes on as it was", name)));
}

}  // namespace splatbus::cli
