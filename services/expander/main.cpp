#include "bus/service.h"
#include "expander/expander.h"
#include "expander/parameters.h"

int main(int argc, char** argv) {
  return splatbus::bus::service_main(
      argc, argv,
      {.kind = "expander",
       .summary = "Grows the model: inserts Gaussians where input samples show what is not modelled yet.",
       .parameters = splatbus::bus::Parameters::declare<splatbus::expander::Options>()},
      splatbus::expander::run);
}
