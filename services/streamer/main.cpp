#include "bus/service.h"
#include "streamer/parameters.h"
#include "streamer/streamer.h"

int main(int argc, char** argv) {
  const splatbus::bus::ServiceDescription description{
      .kind = "streamer",
      .summary = "Sends the Gaussian model to viewers and keeps them up to date",
      .parameters = splatbus::bus::Parameters::declare<splatbus::streamer::Options>(),
      .opens_ports = true,
  };
  return splatbus::bus::service_main(argc, argv, description, [](splatbus::bus::ServiceContext& service) {
    splatbus::streamer::Streamer streamer(service);
    service.ready();
    streamer.run();
  });
}
