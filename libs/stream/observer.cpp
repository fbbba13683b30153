#include "stream/observer.h"

#include <cassert>
#ifdef SPLATBUS_HAVE_CUDA
#include "stream/cuda/cuda_observer.h"
#endif

namespace splatbus::stream {

std::unique_ptr<Observer> make_observer([[maybe_unused]] Device memory) {
#ifdef SPLATBUS_HAVE_CUDA
  if (memory == Device::Cuda) return make_cuda_observer();
#endif
  assert(memory == Device::Cpu);
  return make_host_observer();
}

}  // namespace splatbus::stream
