#include "expander_fixture.h"

namespace splatbus::expander::test {

INSTANTIATE_TEST_SUITE_P(Machines, ExpanderTest,
                         testing::Values(Machine{Device::Cuda, Device::Cuda},
                                         Machine{Device::Cuda, Device::Cpu},
                                         Machine{Device::Cpu, Device::Cuda}),
                         machine_name);

}  // namespace splatbus::expander::test
