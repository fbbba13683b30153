#include "sim/device_readback.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <stdexcept>

#include "bus/backend.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "sim/cuda/gl_interop.h"
#endif

namespace splatbus::sim {

namespace {

bool is_on_first_device([[maybe_unused]] const GlContext& context) {
#ifdef SPLATBUS_HAVE_CUDA
  // Asked first: a software renderer's context is nothing that the driver knows.
  return !context.is_software() && cuda::renders_on_first_device();
#else
  return false;
#endif
}

}  // namespace

std::shared_ptr<GlContext> make_context(const std::string& backend) {
  const bool any = bus::choose_backend(backend) == Device::Cpu;
  return any ? std::make_shared<GlContext>() : std::make_shared<GlContext>(is_on_first_device);
}

std::unique_ptr<DeviceReadback> make_device_readback(const GlContext& context, const std::string& backend) {
  if (bus::choose_backend(backend) == Device::Cpu) return nullptr;
#ifdef SPLATBUS_HAVE_CUDA
  if (is_on_first_device(context)) return std::make_unique<cuda::GlInterop>();
#endif
  const std::string why = fmt::format("{} is not the first CUDA device", context.description());
  if (backend == "cuda") throw std::runtime_error("no backend cuda: " + why);
  spdlog::info("frames go through host memory: {}", why);
  return nullptr;
}

}  // namespace splatbus::sim
