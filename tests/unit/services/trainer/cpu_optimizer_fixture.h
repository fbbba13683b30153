#pragma once

#include "optimizer_fixture.h"

namespace splatbus::trainer {

class CpuOptimizerTest : public OptimizerTest {
 protected:
  CpuOptimizerTest() { scene_ = SyntheticScene(300, 6, 48); }
  Trial trial(const Settings& settings = {}) { return OptimizerTest::trial(Device::Cpu, settings); }
};

}  // namespace splatbus::trainer
