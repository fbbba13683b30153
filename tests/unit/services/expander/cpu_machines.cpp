#include "expander_fixture.h"
#include "insertion_fixture.h"

namespace splatbus::expander::test {

INSTANTIATE_TEST_SUITE_P(Machines, ExpanderTest, testing::Values(Machine{Device::Cpu, Device::Cpu}), machine_name);
INSTANTIATE_TEST_SUITE_P(Devices, InsertionTest, testing::Values(Device::Cpu), device_name);

}  // namespace splatbus::expander::test
