#include "expander/mapper.h"

#include "bus/error.h"
#include "expander/cpu_mapper.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "expander/cuda/cuda_mapper.h"
#endif

namespace splatbus::expander {

std::unique_ptr<Mapper> make_mapper(Device backend, const MapperOptions& options) {
  if (backend == Device::Cpu) return std::make_unique<CpuMapper>(options.cell_size_m);
#ifdef SPLATBUS_HAVE_CUDA
  return std::make_unique<cuda::CudaMapper>(options);
#else
  throw bus::Error("this build has no CUDA backend");
#endif
}

}  // namespace splatbus::expander
