#include "bus/gpu/cuda_slab.h"

#include <cuda_runtime_api.h>
#include <fmt/format.h>

#include <utility>

#include "bus/error.h"
#include "bus/gpu/cuda_driver.h"

namespace splatbus::bus::gpu {
namespace {

CUmemAllocationProp allocation_properties() {
  CUmemAllocationProp properties{};
  properties.type = CU_MEM_ALLOCATION_TYPE_PINNED;
  properties.location.type = CU_MEM_LOCATION_TYPE_DEVICE;
  properties.location.id = 0;
  properties.requestedHandleTypes = CU_MEM_HANDLE_TYPE_POSIX_FILE_DESCRIPTOR;
  return properties;
}

std::size_t allocation_bytes(const Driver& driver, const SlabDescriptor& descriptor) {
  const CUmemAllocationProp properties = allocation_properties();
  std::size_t granularity = 0;
  driver.check(driver.granularity(&granularity, &properties, CU_MEM_ALLOC_GRANULARITY_MINIMUM),
               "asking the granularity");
  return (slab_data_bytes(descriptor) + granularity - 1) / granularity * granularity;
}

}  // namespace

CudaSlab::CudaSlab(const SlabDescriptor& descriptor, ControlBlock control, FileDescriptor data, bool writable)
    : Slab(descriptor, std::move(control), writable), data_fd_(std::move(data)) {}

void CudaSlab::map_allocation(CUmemGenericAllocationHandle allocation, bool writable) {
  const Driver& driver = Driver::get();
  allocation_ = allocation;
  mapped_bytes_ = allocation_bytes(driver, descriptor());
  driver.check(driver.reserve(&address_, mapped_bytes_, 0, 0, 0), "reserving addresses");
  const CUresult mapped = driver.map(address_, mapped_bytes_, 0, allocation_, 0);
  if (mapped != CUDA_SUCCESS) {
    driver.free_address(std::exchange(address_, 0), mapped_bytes_);
    throw Error(
        fmt::format("slab '{}': its allocation does not hold the {} bytes that it claims", name(), mapped_bytes_));
  }
  CUmemAccessDesc access{};
  access.location.type = CU_MEM_LOCATION_TYPE_DEVICE;
  access.location.id = 0;
  access.flags = writable ? CU_MEM_ACCESS_FLAGS_PROT_READWRITE : CU_MEM_ACCESS_FLAGS_PROT_READ;
  driver.check(driver.set_access(address_, mapped_bytes_, &access, 1), "giving access");
  data_ = reinterpret_cast<std::byte*>(address_);
}

std::shared_ptr<CudaSlab> CudaSlab::create(const SlabDescriptor& descriptor, bool shared) {
  const Driver& driver = Driver::get();
  auto control = ControlBlock::create(descriptor, shared);
  const CUmemAllocationProp properties = allocation_properties();
  const std::size_t bytes = allocation_bytes(driver, descriptor);
  CUmemGenericAllocationHandle allocation = 0;
  driver.check(driver.create(&allocation, bytes, &properties, 0), "allocating a slab");
  int fd = -1;
  if (shared) {
    const CUresult exported = driver.export_handle(&fd, allocation, CU_MEM_HANDLE_TYPE_POSIX_FILE_DESCRIPTOR, 0);
    if (exported != CUDA_SUCCESS) driver.release(allocation);
    driver.check(exported, "exporting a slab");
  }
  auto slab = std::shared_ptr<CudaSlab>(new CudaSlab(descriptor, std::move(control), FileDescriptor(fd), true));
  slab->map_allocation(allocation, true);
  if (cudaMemset(slab->data_, 0, bytes) != cudaSuccess) {
    throw Error(fmt::format("slab '{}': clearing it failed", descriptor.name));
  }
  return slab;
}

std::shared_ptr<CudaSlab> CudaSlab::map(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                        bool writable) {
  const Driver& driver = Driver::get();
  auto block = ControlBlock::map(descriptor, std::move(control), writable);
  CUmemGenericAllocationHandle allocation = 0;
  // The driver takes the descriptor's number in the pointer itself.
  void* handle = reinterpret_cast<void*>(static_cast<std::intptr_t>(data.get()));  // NOLINT(performance-no-int-to-ptr)
  if (driver.import_handle(&allocation, handle, CU_MEM_HANDLE_TYPE_POSIX_FILE_DESCRIPTOR) != CUDA_SUCCESS) {
    throw Error(fmt::format("slab '{}': its data descriptor is not CUDA memory", descriptor.name));
  }
  auto slab = std::shared_ptr<CudaSlab>(new CudaSlab(descriptor, std::move(block), std::move(data), writable));
  slab->map_allocation(allocation, writable);
  return slab;
}

CudaSlab::~CudaSlab() {
  try {
    const Driver& driver = Driver::get();
    if (address_ != 0) {
      // Kernels of this process may still read it.
      cudaDeviceSynchronize();
      driver.unmap(address_, mapped_bytes_);
      driver.free_address(address_, mapped_bytes_);
    }
    if (allocation_ != 0) driver.release(allocation_);
  } catch (const Error&) {
    // The device is gone, and the memory with it.
    return;
  }
}

void CudaSlab::read(std::size_t offset, std::size_t bytes, void* destination) const {
  Driver::get();
  const cudaError_t status = cudaMemcpy(destination, data_ + offset, bytes, cudaMemcpyDeviceToHost);
  if (status != cudaSuccess) throw Error(fmt::format("slab '{}': reading it: {}", name(), cudaGetErrorString(status)));
}

}  // namespace splatbus::bus::gpu
