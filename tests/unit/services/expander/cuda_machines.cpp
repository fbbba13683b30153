#include "expander_fixture.h"

namespace splatbus::expander::test {

INSTANTIATE_TEST_SUITE_P(Machines, ExpanderTest,
                         testing::Values(Machine{bus::Backend::Cuda, bus::MemoryKind::Cuda},
                                         Machine{bus::Backend::Cuda, bus::MemoryKind::Host},
                                         Machine{bus::Backend::Cpu, bus::MemoryKind::Cuda}),
                         machine_name);

}  // namespace splatbus::expander::test
