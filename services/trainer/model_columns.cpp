#include "trainer/model_columns.h"

#include "bus/error.h"
#include "trainer/host_columns.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "trainer/cuda/device_columns.h"
#endif

namespace splatbus::trainer {

std::unique_ptr<ModelColumns> make_model_columns(Device memory) {
  if (memory == Device::Cpu) return std::make_unique<HostColumns>();
#ifdef SPLATBUS_HAVE_CUDA
  return std::make_unique<cuda::DeviceColumns>();
#else
  throw bus::Error("this build has no CUDA memory");
#endif
}

}  // namespace splatbus::trainer
