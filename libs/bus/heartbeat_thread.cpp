#include "bus/heartbeat_thread.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <algorithm>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/clock.h"
#include "bus/heartbeat_limits.h"
#include "bus/parameter_json.h"
#include "bus/service.h"
#include "bus/trace.h"
#include "wire/trace_generated.h"
#include "wire/trace_topics.h"

namespace splatbus::bus {
namespace {

constexpr std::int64_t beat_ns = 200'000'000, longest_wait_ms = 20;
constexpr std::int64_t longest_trace_ns = 10'000'000'000;
constexpr std::int64_t patience_ns = 3'000'000'000;  // a bus and its services are started together

/// As much of it as a heartbeat may have, in whole characters and with a mark that it is cut: with more the broker
/// would refuse it, and the service look dead.
std::string shortened(std::string text, std::size_t limit) {
  constexpr std::string_view kCut = "...";
  if (text.size() <= limit) return text;
  std::size_t end = limit - kCut.size();
  while (end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0U) == 0x80U) --end;
  text.resize(end);
  return text.append(kCut);
}

}  // namespace

HeartbeatThread::HeartbeatThread(ServiceContext& service, std::string kind)
    : service_(service), kind_(std::move(kind)), publisher_(service.bus), control_(service.bus) {
  for (const std::string& name : {kind_, service.bus->source()}) {
    control_.on(topics::control("control/" + name),
                [this](const wire::Control& control, const Message& message) { apply(control, message); });
  }
  control_.on(topics::kTraceRequest, [](const wire::TraceRequest& request, const Message&) {
    SpanLog::of_process().record_until(std::min(request.until_ns(), now_ns() + longest_trace_ns));
  });
  beat(wire::ServiceState::Starting);
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

HeartbeatThread::~HeartbeatThread() = default;

void HeartbeatThread::finish(wire::ServiceState state, const std::string& reason) {
  thread_.request_stop();
  thread_.join();
  if (!reason.empty()) service_.detail(reason);
  beat(state);
}

void HeartbeatThread::run(const std::stop_token& stop) {
  const std::int64_t began = now_ns();
  std::int64_t next_beat = began + beat_ns;
  bool has_looked = false;
  while (!stop.stop_requested()) {
    const std::int64_t left_ms = std::max<std::int64_t>(0, (next_beat - now_ns()) / 1'000'000);
    // A short wait: others start when this one is ready, and finish() waits for the thread.
    control_.dispatch_all(std::chrono::milliseconds(std::min<std::int64_t>(left_ms, longest_wait_ms)));
    const bool due = now_ns() >= next_beat;
    if (due || state() != said_state_) beat(state());
    if (!due) continue;
    next_beat = std::max(next_beat + beat_ns, now_ns());
    if (!has_looked && now_ns() - began > patience_ns) {
      has_looked = true;
      if (!service_.bus->wait_connected(std::chrono::milliseconds(0))) {
        spdlog::warn("no broker answers at {} yet; this waits for one", service_.bus->address().text());
      }
    }
    publish_spans();
  }
}

void HeartbeatThread::publish_spans() {
  const SpanLog::Taken taken = SpanLog::of_process().take();
  if (taken.spans.empty() && taken.lost == 0) return;
  publisher_.publish(topics::kSpans, [&](auto& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::WorkSpan>> spans;
    spans.reserve(taken.spans.size());
    for (const WorkSpan& span : taken.spans) {
      // Names are few: each is written once.
      spans.push_back(wire::CreateWorkSpan(builder, builder.CreateSharedString(span.name), span.begin_ns, span.end_ns,
                                           span.capture_ns, span.scene_version, span.thread));
    }
    return wire::CreateSpansDirect(builder, header, static_cast<std::uint32_t>(::getpid()), &spans, taken.lost);
  });
}

wire::ServiceState HeartbeatThread::state() const {
  if (!service_.ready_) return wire::ServiceState::Starting;
  return service_.stands_by_ ? wire::ServiceState::Standby : wire::ServiceState::Running;
}

void HeartbeatThread::apply(const wire::Control& control, const Message& message) {
  if (control.order() != wire::Order::None && control.pid() == static_cast<std::uint32_t>(::getpid())) {
    obey(control.order());
  }
  if (control.changes() == nullptr) return;
  for (const auto* change : *control.changes()) {
    const auto name = change->key()->str();
    const auto value = change->value()->str();
    const auto problem = service_.parameters.set(name, value, true);
    if (!said_.take(1, now_ns())) continue;  // a peer has us say it
    if (problem.empty()) {
      spdlog::info("{} set to {} by {}", name, value, message.header().source()->str());
    } else {
      spdlog::error("{} (asked for by {})", problem, message.header().source()->str());
    }
  }
  beat(state());
}

void HeartbeatThread::obey(wire::Order order) {
  if (order == wire::Order::Yield && !service_.stands_by_) {
    spdlog::info("hands over to a successor");
    service_.yields_ = true;
    if (service_.request_stop_) service_.request_stop_();
  } else if (order == wire::Order::TakeOver && service_.stands_by_) {
    const std::scoped_lock lock(service_.mutex_);
    service_.told_to_take_over_ = true;
    service_.told_.notify_all();
  }
}

void HeartbeatThread::beat(wire::ServiceState state) {
  said_state_ = state;
  std::map<std::string, double> counters;
  std::string detail;
  {
    const std::scoped_lock lock(service_.mutex_);
    counters = service_.counters_;
    detail = shortened(service_.detail_, HeartbeatLimits::kText);
  }
  const MessageInfo info{.capture_ns = 0, .latch_key = service_.bus->source(), .tensors = {}};
  publisher_.publish(topics::kHeartbeat, info, [&](auto& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::Counter>> counter_offsets;
    counter_offsets.reserve(counters.size());
    for (const auto& [name, value] : counters) {
      counter_offsets.push_back(
          wire::CreateCounterDirect(builder, shortened(name, HeartbeatLimits::kKey).c_str(), value));
    }
    std::vector<flatbuffers::Offset<wire::KeyValue>> parameter_offsets;
    const auto parameters = service_.parameters.list();
    const std::vector<ParameterSpec>& specs = service_.parameters.specs();
    parameter_offsets.reserve(parameters.size());
    for (std::size_t i = 0; i < parameters.size(); ++i) {
      const auto& [name, value] = parameters[i];
      parameter_offsets.push_back(wire::CreateKeyValueDirect(
          builder, name.c_str(), shortened(value, HeartbeatLimits::kText).c_str(), value_type(specs[i])));
    }
    return wire::CreateHeartbeatDirect(builder, header, kind_.c_str(), static_cast<std::uint32_t>(::getpid()), state,
                                       detail.c_str(), &counter_offsets, &parameter_offsets, name_of(service_.backend),
                                       kProtocolVersion);
  });
}

ServiceContext::ServiceContext(std::shared_ptr<Context> context, Parameters& service_parameters,
                               std::stop_token stop_token, Device service_backend)
    : bus(std::move(context)), parameters(service_parameters), stop(std::move(stop_token)), backend(service_backend) {}

void ServiceContext::counter(const std::string& name, double value) {
  const std::scoped_lock lock(mutex_);
  counters_[name] = value;
}

void ServiceContext::detail(const std::string& text) {
  const std::scoped_lock lock(mutex_);
  detail_ = text;
}

std::string successor_name(const std::string& name) {
  return name + ".next";
}

bool ServiceContext::take_over(const std::function<void()>& turn) {
  if (!stands_by_) return true;
  ready();
  while (!told_to_take_over_ && !stop.stop_requested()) {
    if (turn) {
      turn();
      continue;
    }
    std::unique_lock lock(mutex_);
    told_.wait(lock, stop, [this] { return told_to_take_over_.load(); });
  }
  if (stop.stop_requested()) return false;
  change_name_();
  return true;
}

}  // namespace splatbus::bus
