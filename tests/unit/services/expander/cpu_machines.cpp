#include "expander_fixture.h"

namespace splatbus::expander::test {

INSTANTIATE_TEST_SUITE_P(Machines, ExpanderTest, testing::Values(Machine{Device::Cpu, Device::Cpu}),
                         machine_name);

}  // namespace splatbus::expander::test
