#include "bus/service.h"
#include "trainer/options.h"
#include "trainer/trainer.h"

int main(int argc, char** argv) {
  const splatbus::bus::ServiceDescription description{
      .kind = "trainer",
      .summary = "Holds the Gaussian model and trains it on the engine's pictures",
      .parameters = splatbus::bus::Parameters::declare<splatbus::trainer::Options>(),
      .stands_by = true,
  };
  return splatbus::bus::service_main(argc, argv, description, [](splatbus::bus::ServiceContext& service) {
    splatbus::trainer::Trainer(service).run();
  });
}
