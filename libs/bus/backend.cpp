#include "bus/backend.h"

#include <fmt/format.h>

#include "bus/permanent_error.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "bus/gpu/cuda_driver.h"
#endif

namespace splatbus::bus {
namespace {

/// Why there is no CUDA here; empty when there is.
std::string obstacle() {
#ifdef SPLATBUS_HAVE_CUDA
  try {
    (void)gpu::Driver::get();
    return {};
  } catch (const Error& error) {
    return error.what();
  }
#else
  return "this build has none";
#endif
}

}  // namespace

Device choose_backend(const std::string& text) {
  if (text == "cpu") return Device::Cpu;
  if (text != "cuda" && text != "auto") {
    throw Error(fmt::format("backend '{}' does not exist: cpu, cuda or auto", text));
  }
  const std::string why = obstacle();
  if (why.empty()) return Device::Cuda;
  if (text == "cuda") throw PermanentError(fmt::format("no backend cuda: {}", why));
  return Device::Cpu;
}

}  // namespace splatbus::bus
