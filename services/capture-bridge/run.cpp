#include "capture-bridge/capture_bridge.h"

namespace splatbus::capture_bridge {

void run(bus::ServiceContext& service) {
  CaptureBridge bridge(service.bus, service.parameters, service.backend);
  while (!service.stop.stop_requested()) {
    bridge.step(std::chrono::milliseconds(20));
    const BridgeCounters& counters = bridge.counters();
    const InputStatistics input = bridge.input_statistics();
    service.detail(counters.frames == 0 ? "waiting for the engine's first frame" : "");
    service.counter("frames", static_cast<double>(counters.frames));
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
    service.counter("host_copied_bytes", static_cast<double>(bridge.host_copied_bytes()));
  }
}

}  // namespace splatbus::capture_bridge
