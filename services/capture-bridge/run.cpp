#include <spdlog/spdlog.h>

#include <optional>

#include "bus/clock.h"
#include "bus/frames.h"
#include "capture-bridge/capture_bridge.h"
#include "capture-bridge/lead.h"
#include "capture-bridge/parameters.h"
#include "capture-bridge/round_helper.h"
#include "wire/system_generated.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::chrono::milliseconds kTurn(20);

void report(bus::ServiceContext& service, CaptureBridge& bridge) {
  const BridgeCounters& counters = bridge.counters();
  const InputStatistics input = bridge.input_statistics();
  service.detail(counters.frames == 0 ? "waiting for the engine's first frame" : "");
  service.counter("frames", static_cast<double>(counters.frames));
  service.counter("engines", static_cast<double>(bridge.engines().in_use()));
  service.counter("engines_resting", static_cast<double>(bridge.engines().resting()));
  service.counter("frames_followed", static_cast<double>(counters.frames_followed));
  service.counter("frames_unmatched", static_cast<double>(counters.frames_unmatched));
  service.counter("frames_lost", static_cast<double>(counters.frames_lost + bridge.subscriber().lost()));
  service.counter("refused", static_cast<double>(counters.refused));
  service.counter("references", static_cast<double>(counters.references));
  service.counter("inputs", static_cast<double>(counters.inputs));
  service.counter("glances", static_cast<double>(counters.glances));
  service.counter("inputs_blind", static_cast<double>(counters.inputs_blind));
  service.counter("ranges", static_cast<double>(counters.ranges));
  service.counter("viewers", static_cast<double>(bridge.viewers()));
  service.counter("poses_dropped", static_cast<double>(counters.poses_dropped));
  service.counter("probes", static_cast<double>(counters.probes));
  service.counter("probes_dropped", static_cast<double>(counters.probes_dropped));
  service.counter("light_depths", static_cast<double>(counters.light_depths));
  service.counter("cameras", static_cast<double>(bridge.cameras()));
  service.counter("input_rounds", static_cast<double>(input.rounds));
  service.counter("samples", static_cast<double>(input.samples));
  service.counter("samples_culled", static_cast<double>(input.culled));
  service.counter("samples_thinned", static_cast<double>(input.thinned));
  service.counter("samples_dropped", static_cast<double>(input.dropped));
  service.counter("sampling_ms", input.milliseconds);
  service.counter("helpers", static_cast<double>(bridge.sharing().helpers()));
  service.counter("rounds_handed", static_cast<double>(bridge.sharing().handed()));
  service.counter("rounds_came_back", static_cast<double>(bridge.sharing().came_back()));
  service.counter("host_copied_bytes", static_cast<double>(bridge.host_copied_bytes()));
}

void report(bus::ServiceContext& service, const RoundHelper& helper) {
  const RoundHelper::Counters& counters = helper.counters();
  service.counter("rounds_helped", static_cast<double>(counters.rounds));
  service.counter("rounds_refused", static_cast<double>(counters.refused));
  service.counter("samples", static_cast<double>(counters.samples));
  service.counter("sampling_ms", counters.milliseconds);
  service.counter("host_copied_bytes", static_cast<double>(helper.host_copied_bytes()));
}

}  // namespace

void run(bus::ServiceContext& service) {
  Lead lead({.since_ns = service.bus->epoch(), .name = service.bus->source()});
  std::optional<CaptureBridge> bridge;
  std::optional<RoundHelper> helper;
  std::optional<bus::Message> newest;
  bus::Subscriber broker(service.bus);
  broker.on(topics::kLiveness, [&](const wire::Liveness& liveness, const bus::Message& message) {
    lead.take(liveness, bus::now_ns());
    if (bridge) bridge->take(liveness);
    newest = message;
  });
  while (!service.stop.stop_requested()) {
    broker.dispatch_all(std::chrono::milliseconds(0));
    if (!lead.may_write(bus::now_ns())) {
      if (bridge && !lead.is_first()) {
        spdlog::info("{} leads: sampling rounds for it", bus::printable(lead.leader().name));
        bridge.reset();
      }
      service.detail(lead.why_not());
      if (lead.is_first() || lead.leader().name.empty()) {
        broker.dispatch_all(kTurn);
        continue;
      }
      if (!helper) {
        const bus::LiveOptions<Options> options(service.parameters);
        helper.emplace(service.bus, service.backend, options->round_sizes());
      }
      helper->step(kTurn);
      report(service, *helper);
      continue;
    }
    helper.reset();
    if (!bridge) {
      // As one that is started again: what the one before knew is asked for anew.
      bridge.emplace(service.bus, service.parameters, service.backend);
      bridge->take(newest->root<wire::Liveness>());
    }
    bridge->step(kTurn);
    report(service, *bridge);
  }
}

}  // namespace splatbus::capture_bridge
