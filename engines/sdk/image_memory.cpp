#include "sdk/image_memory.h"

#include <fmt/format.h>

#include "bus/backend.h"
#include "bus/error.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "sdk/cuda/device_pointer.h"
#endif

namespace splatbus::engine_sdk {

Device memory_kind(std::uint32_t memory) {
  switch (memory) {
    case SPLATBUS_MEMORY_HOST:
      return Device::Cpu;
    case SPLATBUS_MEMORY_CUDA:
      return bus::choose_backend("cuda");
    default:
      throw bus::Error(fmt::format("{} is not a kind of memory", memory));
  }
}

std::string memory_problem(const splatbus_image& image) {
  switch (image.memory) {
    case SPLATBUS_MEMORY_HOST:
      return {};
    case SPLATBUS_MEMORY_CUDA:
#ifdef SPLATBUS_HAVE_CUDA
      return cuda::pointer_problem(image.data, image.bytes);
#else
      return "its memory is CUDA's, which this build does not have";
#endif
    default:
      return fmt::format("its memory is {}, which does not exist", image.memory);
  }
}

}  // namespace splatbus::engine_sdk
