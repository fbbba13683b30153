// A service for the tests of service_main and of processes that die: it makes a slab, publishes where it lies, and
// counts until it is stopped.
#include <chrono>
#include <cstring>
#include <stdexcept>
#include <thread>

#include "bus/error.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/trace.h"
#include "slab_helpers.h"
#include "wire/viewer_generated.h"

namespace {

using namespace splatbus;

struct Options {
  std::uint64_t number = 7;
  bool fail = false;
  double rate_hz = 5;
  std::string fixed = "a";
  double linger_s = 0;

  void bind(bus::ParameterBinder& p) {
    p.add("number", number, "what it publishes, a count");
    p.add("fail", fail, "makes it fail");
    p.add("rate_hz", rate_hz, "hertz", {1, 10});
    p.add("fixed", fixed, "a name", bus::kFixed);
    p.add("linger_s", linger_s, "for how long the process stays when the service has ended, s", {0, 1000});
  }
};

std::chrono::duration<double> linger{0};

void publish_model(bus::ServiceContext& service, bus::Publisher& publisher, bus::Slab& slab) {
  const bus::MessageInfo info{.capture_ns = 0, .latch_key = {}, .tensors = {bus_test::write_floats(slab, {1, 2, 3})}};
  publisher.publish(Topic<wire::ViewerProbe>{"test/model", topics::kLatched}, info, [&](auto& builder, auto header) {
    const wire::Camera camera;
    return wire::CreateViewerProbe(builder, header, service.parameters.read<Options>().number, &camera);
  });
}

void run(bus::ServiceContext& service) {
  // A successor reads before it takes over, and keeps what it reads with.
  bus::Subscriber kept(service.bus, {"sys/liveness"});
  if (!service.take_over([&] { static_cast<void>(kept.receive(std::chrono::milliseconds(10))); })) return;
  service.ready();
  service.detail("counting");
  linger = std::chrono::duration<double>(service.parameters.read<Options>().linger_s);
  if (service.parameters.read<Options>().fixed.size() > 100) service.counter(std::string(300, 'n'), 1);
  const auto mortal = service.bus->create_slab("frames", 1, 4096);
  const auto slab = service.bus->create_slab("model", 1, 4096, 10000, splatbus::Device::Cpu,
                                             splatbus::bus::Context::SlabLife::ForSuccessor);
  bus::Publisher publisher(service.bus);
  publish_model(service, publisher, *slab);
  for (int turns = 0; !service.stop.stop_requested(); ++turns) {
    const bus::TracedWork work("turn", 0, 7);
    service.counter("turns", turns);
    if (service.parameters.read<Options>().fail) throw bus::Error("told to fail");
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

}  // namespace

int main(int argc, char** argv) {
  const bus::ServiceDescription description{
      .kind = "test",
      .summary = "A service for tests",
      .parameters = bus::Parameters::declare<Options>(),
      .stands_by = true,
  };
  const int status = bus::service_main(argc, argv, description, run);
  std::this_thread::sleep_for(linger);
  return status;
}
