#include "device/check.h"

#include <stdexcept>
#include <string>

namespace splatbus::device {

namespace {

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
