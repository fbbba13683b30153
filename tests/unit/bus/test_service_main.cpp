// A service for the tests of service_main and of processes that die: it makes a slab, publishes where it lies, and
// counts until it is stopped.
#include <cstring>
#include <stdexcept>
#include <thread>

#include "bus/error.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "slab_helpers.h"
#include "wire/viewer_generated.h"

namespace {

using namespace splatbus;

void publish_model(bus::ServiceContext& service, bus::Publisher& publisher, bus::Slab& slab) {
  const bus::MessageInfo info{.schema = "ViewerProbe/1",
                              .capture_ns = 0,
                              .latch = true,
                              .latch_key = {},
                              .tensors = {bus_test::write_floats(slab, {1, 2, 3})}};
  publisher.publish(info, [&](auto& builder, auto header) {
    const wire::Camera camera;
    return wire::CreateViewerProbe(builder, header, service.parameters.integer("number"), &camera);
  });
}

void run(bus::ServiceContext& service) {
  service.detail("counting");
  const auto slab = service.bus->create_slab("model", 1, 4096);
  bus::Publisher publisher(service.bus, "test/model");
  publish_model(service, publisher, *slab);
  for (int turns = 0; !service.stop.stop_requested(); ++turns) {
    service.counter("turns", turns);
    if (service.parameters.boolean("fail")) throw bus::Error("told to fail");
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

}  // namespace

int main(int argc, char** argv) {
  using bus::ParameterSpec;
  const bus::ServiceDescription description{
      "test",
      "A service for tests",
      {ParameterSpec{.name = "number", .default_value = std::int64_t{7}, .description = "what it publishes, a count"},
       ParameterSpec{.name = "fail", .default_value = false, .description = "makes it fail"},
       ParameterSpec{.name = "rate_hz", .default_value = 5.0, .description = "hertz", .minimum = 1, .maximum = 10},
       ParameterSpec{.name = "fixed", .default_value = std::string("a"), .description = "a name", .runtime = false}}};
  return bus::service_main(argc, argv, description, run);
}
