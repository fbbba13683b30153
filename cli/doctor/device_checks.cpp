#include <fmt/format.h>
#include <unistd.h>

#include <exception>

#include "bus/backend.h"
#include "bus/error.h"
#include "checks.h"
#include "gl/context.h"
#include "gpu_usage.h"

namespace splatbus::cli {

Check check_gpu() {
  Check check{.name = "GPU"};
  const auto devices = query_gpus();
  const bool has_device = !devices.empty() || ::access("/dev/nvidiactl", F_OK) == 0;
  for (const GpuUsage& gpu : devices) {
    check.found += fmt::format("{}{}, driver {}, {:.0f} of {:.0f} MiB used", check.found.empty() ? "" : "; ", gpu.name,
                               gpu.driver, gpu.used_mib, gpu.total_mib);
  }
  try {
    static_cast<void>(bus::choose_backend("cuda"));
  } catch (const bus::Error& error) {
    check.found += fmt::format("{}{}", check.found.empty() ? "" : "; ", error.what());
    if (has_device) {
      check.verdict = Verdict::Warn;
      check.advice =
          "there is an NVIDIA GPU that is not used: install a driver of CUDA 12 or later and the package with CUDA";
    } else {
      check.found += "; everything runs on the CPU";
    }
  }
  return check;
}

Check check_egl() {
  try {
    const GlContext context;
    Check check{.name = "EGL", .found = context.description()};
    if (context.is_software() && ::access("/dev/nvidiactl", F_OK) == 0) {
      check.verdict = Verdict::Warn;
      check.advice =
          "OpenGL runs on the CPU though there is a GPU: install its EGL driver "
          "(in a container, NVIDIA_DRIVER_CAPABILITIES=all)";
    }
    return check;
  } catch (const std::exception& error) {
    return {"EGL", Verdict::Fail, error.what(),
            "install an EGL driver, such as Debian's libegl-mesa0 and libgl1-mesa-dri"};
  }
}

}  // namespace splatbus::cli
