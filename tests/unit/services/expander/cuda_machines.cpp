#include "expander_fixture.h"
#include "insertion_fixture.h"

namespace splatbus::expander::test {

INSTANTIATE_TEST_SUITE_P(Machines, ExpanderTest,
                         testing::Values(Machine{Device::Cuda, Device::Cuda}, Machine{Device::Cuda, Device::Cpu},
                                         Machine{Device::Cpu, Device::Cuda}),
                         machine_name);
INSTANTIATE_TEST_SUITE_P(Devices, InsertionTest, testing::Values(Device::Cuda), device_name);

}  // namespace splatbus::expander::test
