#include "device/check.h"

#include <stdexcept>
#include <string>

namespace splatbus::device {

void check(cudaError_t status, const char* what) {
  if (status == cudaSuccess) return;
  throw std::runtime_error(std::string("CUDA: ") + what + ": " + cudaGetErrorString(status));
}

}  // namespace splatbus::device
