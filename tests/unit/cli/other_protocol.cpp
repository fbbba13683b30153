// A successor of tomorrow: its heartbeats name a later version of the protocol.
#include <unistd.h>

#include <chrono>
#include <thread>

#include "bus/publisher.h"
#include "wire/system_generated.h"

int main(int /*argc*/, char** argv) {
  using namespace splatbus;
  const auto context = bus::Context::create(bus::Address::parse(argv[1]), "test.next");
  const bus::Publisher publisher(context);
  while (true) {
    publisher.publish(
        topics::kHeartbeat, {.capture_ns = 0, .latch_key = "test.next", .tensors = {}}, [](auto& builder, auto header) {
          return wire::CreateHeartbeatDirect(builder, header, "test", static_cast<std::uint32_t>(::getpid()),
                                             wire::ServiceState::Standby, "", nullptr, nullptr, "cpu",
                                             kProtocolVersion + 1);
        });
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
}
