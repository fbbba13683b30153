#include "device/check.h"

#include <stdexcept>
#include <string>

namespace splatbus::device {

void check(cudaError_t status, const char* what) {
  if (status == cudaSuccess) return;
  static_cast<void>(cudaGetLastError());  // else the next launch is blamed for it
  throw std::runtime_error(std::string("CUDA: ") + what + ": " + cudaGetErrorString(status));
}

}  // namespace splatbus::device
