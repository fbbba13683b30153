#include "bus/service.h"
#include "capture-bridge/capture_bridge.h"
#include "capture-bridge/parameters.h"

int main(int argc, char** argv) {
  return splatbus::bus::service_main(
      argc, argv,
      {.kind = "capture-bridge",
       .summary =
           "Asks the engine for input, reference and light cameras, and turns its frames into samples and views.",
       .parameters = splatbus::bus::Parameters::declare<splatbus::capture_bridge::Options>()},
      splatbus::capture_bridge::run);
}
