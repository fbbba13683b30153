#include "bus/service.h"
#include "relight/relight.h"

int main(int argc, char** argv) {
  const splatbus::bus::ServiceDescription description{
      .kind = "relight",
      .summary = "Tests which Gaussians the sun reaches",
      .parameters = splatbus::bus::Parameters::declare<splatbus::relight::RelightOptions>(),
  };
  return splatbus::bus::service_main(argc, argv, description, [](splatbus::bus::ServiceContext& service) {
    splatbus::relight::Relight(service).run();
  });
}
