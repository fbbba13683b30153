#include "fault.h"

namespace splatbus::bus_test {
namespace {

__global__ void trap_kernel() {
  asm("trap;");
}

}  // namespace

void launch_fault() {
  trap_kernel<<<1, 1, 0, cudaStreamPerThread>>>();
}

}  // namespace splatbus::bus_test
