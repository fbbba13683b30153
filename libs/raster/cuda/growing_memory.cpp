#include "raster/cuda/growing_memory.h"

#include <cuda.h>

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "device/check.h"

namespace splatbus::raster::cuda {
namespace {

using device::check;

/// A function of the driver: a program that links to libcuda does not start where there is none.
template <class Function>
Function* driver_function(const char* name) {
  constexpr unsigned kVersion = 12000;  // whose signatures cuda.h declares under these names
  void* function = nullptr;
  cudaDriverEntryPointQueryResult result{};
  check(cudaGetDriverEntryPointByVersion(name, &function, kVersion, cudaEnableDefault, &result),
        "looking up a function of the driver");
  if (result != cudaDriverEntryPointSuccess) throw std::runtime_error(std::string("CUDA: the driver has no ") + name);
  return reinterpret_cast<Function*>(function);
}

struct Driver {
  decltype(cuMemGetAllocationGranularity)* granularity =
      driver_function<decltype(cuMemGetAllocationGranularity)>("cuMemGetAllocationGranularity");
  decltype(cuMemAddressReserve)* reserve = driver_function<decltype(cuMemAddressReserve)>("cuMemAddressReserve");
  decltype(cuMemAddressFree)* free_addresses = driver_function<decltype(cuMemAddressFree)>("cuMemAddressFree");
  decltype(cuMemCreate)* create = driver_function<decltype(cuMemCreate)>("cuMemCreate");
  decltype(cuMemRelease)* release = driver_function<decltype(cuMemRelease)>("cuMemRelease");
  decltype(cuMemMap)* map = driver_function<decltype(cuMemMap)>("cuMemMap");
  decltype(cuMemUnmap)* unmap = driver_function<decltype(cuMemUnmap)>("cuMemUnmap");
  decltype(cuMemSetAccess)* set_access = driver_function<decltype(cuMemSetAccess)>("cuMemSetAccess");

  static const Driver& get() {
    static const Driver driver;
    return driver;
  }
};

/// The driver's errors have the runtime's numbers.
cudaError_t status(CUresult result) {
  return static_cast<cudaError_t>(result);
}

CUdeviceptr address_of(const std::byte* data) {
  return reinterpret_cast<CUdeviceptr>(data);
}

std::size_t rounded_up(std::size_t bytes, std::size_t to) {
  return (bytes + to - 1) / to * to;
}

/// Memory of the allocation at `address`, which is the only owner from then on.
void map_new(CUdeviceptr address, std::size_t bytes, const CUmemAllocationProp& kind) {
  const Driver& driver = Driver::get();
  CUmemGenericAllocationHandle allocation = 0;
  device::check_allocation(status(driver.create(&allocation, bytes, &kind, 0)), "allocating a model's moments", bytes);
  CUresult result = driver.map(address, bytes, 0, allocation, 0);
  if (result == CUDA_SUCCESS) {
    const CUmemAccessDesc access{.location = kind.location, .flags = CU_MEM_ACCESS_FLAGS_PROT_READWRITE};
    result = driver.set_access(address, bytes, &access, 1);
    if (result != CUDA_SUCCESS) driver.unmap(address, bytes);
  }
  driver.release(allocation);
  check(status(result), "mapping memory");
}

}  // namespace

void GrowingMemory::grow(std::size_t bytes, cudaStream_t stream) {
  if (bytes <= bytes_) return;
  if (bytes > max_bytes_) throw std::runtime_error("CUDA: more memory than addresses were reserved for");
  const Driver& driver = Driver::get();
  CUmemAllocationProp kind{};
  kind.type = CU_MEM_ALLOCATION_TYPE_PINNED;
  kind.location.type = CU_MEM_LOCATION_TYPE_DEVICE;
  check(cudaGetDevice(&kind.location.id), "asking for the device");
  std::size_t granularity = 0;
  check(status(driver.granularity(&granularity, &kind, CU_MEM_ALLOC_GRANULARITY_MINIMUM)), "asking for a granularity");
  if (data_ == nullptr) {
    reserved_ = rounded_up(max_bytes_, granularity);
    CUdeviceptr address = 0;
    check(status(driver.reserve(&address, reserved_, 0, 0, 0)), "reserving addresses");
    data_ = reinterpret_cast<std::byte*>(address);  // NOLINT(performance-no-int-to-ptr): a number to the driver
  }
  const std::size_t more = rounded_up(bytes - bytes_, granularity);
  pieces_.reserve(pieces_.size() + 1);
  map_new(address_of(data_) + bytes_, more, kind);
  pieces_.push_back(more);
  check(cudaMemsetAsync(data_ + bytes_, 0, more, stream), "clearing memory");
  bytes_ += more;
}

GrowingMemory::~GrowingMemory() {
  if (data_ == nullptr) return;
  const Driver& driver = Driver::get();
  cudaDeviceSynchronize();  // nothing may use what is unmapped
  CUdeviceptr address = address_of(data_);
  for (const std::size_t piece : pieces_) {
    driver.unmap(address, piece);
    address += piece;
  }
  driver.free_addresses(address_of(data_), reserved_);
}

GrowingMemory::GrowingMemory(GrowingMemory&& other) noexcept
    : max_bytes_(other.max_bytes_),
      reserved_(std::exchange(other.reserved_, 0)),
      bytes_(std::exchange(other.bytes_, 0)),
      data_(std::exchange(other.data_, nullptr)),
      pieces_(std::exchange(other.pieces_, {})) {}

GrowingMemory& GrowingMemory::operator=(GrowingMemory&& other) noexcept {
  std::swap(max_bytes_, other.max_bytes_);
  std::swap(reserved_, other.reserved_);
  std::swap(bytes_, other.bytes_);
  std::swap(data_, other.data_);
  std::swap(pieces_, other.pieces_);
  return *this;
}

}  // namespace splatbus::raster::cuda
