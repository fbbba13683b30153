#include "trainer/model_columns.h"

#include "bus/error.h"
#include "trainer/host_columns.h"

namespace splatbus::trainer {

std::unique_ptr<ModelColumns> make_model_columns(bus::MemoryKind memory) {
  if (memory == bus::MemoryKind::Host) return std::make_unique<HostColumns>();
  throw bus::Error("this build has no model in CUDA memory");
}

}  // namespace splatbus::trainer
