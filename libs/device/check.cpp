#include "device/check.h"

#include <cstdlib>
#include <stdexcept>
#include <string>

namespace splatbus::device {

namespace {

// All kernels are loaded when the device is opened, before anything is timed, and not one by one where each is first
// launched, which takes up to a second. The driver reads this at the process's first CUDA call.
[[maybe_unused]] const int loads_eagerly = ::setenv("CUDA_MODULE_LOADING", "EAGER", 0);

[[noreturn]] void fail(cudaError_t status, const std::string& what) {
  static_cast<void>(cudaGetLastError());  // else the next launch is blamed for it
  throw std::runtime_error("CUDA: " + what + ": " + cudaGetErrorString(status));
}

}  // namespace

void check(cudaError_t status, const char* what) {
  if (status != cudaSuccess) fail(status, what);
}

void check_allocation(cudaError_t status, const char* what, std::size_t bytes) {
  if (status != cudaSuccess) fail(status, std::string(what) + " of " + std::to_string(bytes) + " bytes");
}

}  // namespace splatbus::device
