#include "bus/gpu/cuda_driver.h"

#include <cuda_runtime_api.h>
#include <fmt/format.h>

#include "bus/error.h"

namespace splatbus::bus::gpu {
namespace {

void check_runtime(cudaError_t status, const char* what) {
  if (status != cudaSuccess) throw Error(fmt::format("CUDA: {}: {}", what, cudaGetErrorString(status)));
}

template <class Function>
void look_up(const char* name, Function& function) {
  void* address = nullptr;
  cudaDriverEntryPointQueryResult result{};
  // 12.0: the version whose signatures cuda.h declares under these names.
  check_runtime(cudaGetDriverEntryPointByVersion(name, &address, 12000, cudaEnableDefault, &result), name);
  if (result != cudaDriverEntryPointSuccess || address == nullptr) {
    throw Error(fmt::format("CUDA: the driver has no {}", name));
  }
  function = reinterpret_cast<Function>(address);
}

Driver load() {
  Driver driver{};
  look_up("cuGetErrorString", driver.error_string);
  look_up("cuMemGetAllocationGranularity", driver.granularity);
  look_up("cuMemCreate", driver.create);
  look_up("cuMemRelease", driver.release);
  look_up("cuMemExportToShareableHandle", driver.export_handle);
  look_up("cuMemImportFromShareableHandle", driver.import_handle);
  look_up("cuMemGetAllocationPropertiesFromHandle", driver.properties);
  look_up("cuMemAddressReserve", driver.reserve);
  look_up("cuMemAddressFree", driver.free_address);
  look_up("cuMemMap", driver.map);
  look_up("cuMemUnmap", driver.unmap);
  look_up("cuMemSetAccess", driver.set_access);
  return driver;
}

}  // namespace

const Driver& Driver::get() {
  check_runtime(cudaSetDevice(0), "choosing the device");
  static const Driver driver = load();
  return driver;
}

void Driver::check(CUresult result, const std::string& what) const {
  if (result == CUDA_SUCCESS) return;
  const char* words = nullptr;
  error_string(result, &words);
  throw Error(fmt::format("{}: {}", what, words != nullptr ? words : "unknown error"));
}

}  // namespace splatbus::bus::gpu
