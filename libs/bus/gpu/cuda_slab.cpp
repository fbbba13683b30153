#include "bus/gpu/cuda_slab.h"

#include <cuda_runtime_api.h>
#include <fcntl.h>
#include <fmt/format.h>

#include <cstdint>
#include <utility>

#include "bus/error.h"
#include "bus/gpu/cuda_driver.h"

namespace splatbus::bus::gpu {
namespace {

constexpr CUmemAllocationHandleType handle_type = CU_MEM_HANDLE_TYPE_POSIX_FILE_DESCRIPTOR;
constexpr int device = 0;

std::string in_slab(const std::string& name, const std::string& what) {
  return fmt::format("slab '{}': {}", name, what);
}

const Driver& driver_for(const std::string& slab) {
  try {
    return Driver::get();
  } catch (const Error& error) {
    throw Error(in_slab(slab, error.what()));
  }
}

void check_runtime(cudaError_t status, const std::string& slab, const char* what) {
  if (status == cudaSuccess) return;
  static_cast<void>(cudaGetLastError());  // else this thread's next launch is blamed for it
  throw Error(in_slab(slab, fmt::format("{}: {}", what, cudaGetErrorString(status))));
}

CUmemAllocationProp allocation_properties() {
  CUmemAllocationProp properties{};
  properties.type = CU_MEM_ALLOCATION_TYPE_PINNED;
  properties.location.type = CU_MEM_LOCATION_TYPE_DEVICE;
  properties.location.id = device;
  properties.requestedHandleTypes = handle_type;
  return properties;
}

std::size_t allocation_bytes(const Driver& driver, const SlabDescriptor& descriptor) {
  const CUmemAllocationProp properties = allocation_properties();
  std::size_t granularity = 0;
  driver.check(driver.granularity(&granularity, &properties, CU_MEM_ALLOC_GRANULARITY_MINIMUM),
               in_slab(descriptor.name, "asking the granularity"));
  return (slab_data_bytes(descriptor) + granularity - 1) / granularity * granularity;
}

FileDescriptor export_allocation(const Driver& driver, CUmemGenericAllocationHandle allocation,
                                 const std::string& slab) {
  int fd = -1;
  driver.check(driver.export_handle(&fd, allocation, handle_type, 0), in_slab(slab, "exporting its memory"));
  FileDescriptor result(fd);
  // A child of this process would keep the memory for as long as it runs.
  if (::fcntl(fd, F_SETFD, FD_CLOEXEC) != 0) throw Error(in_slab(slab, "its descriptor is not valid"));
  return result;
}

}  // namespace

CudaSlab::CudaSlab(const SlabDescriptor& descriptor, ControlBlock control, bool writable)
    : Slab(descriptor, std::move(control), writable) {}

void CudaSlab::map_allocation() {
  const Driver& driver = driver_for(name());
  mapped_bytes_ = allocation_bytes(driver, descriptor());
  CUdeviceptr address = 0;
  driver.check(driver.reserve(&address, mapped_bytes_, 0, 0, 0), in_slab(name(), "reserving addresses"));
  const CUresult mapped = driver.map(address, mapped_bytes_, 0, allocation_, 0);
  if (mapped != CUDA_SUCCESS) driver.free_address(address, mapped_bytes_);
  driver.check(mapped, in_slab(name(), fmt::format("mapping the {} bytes that it claims", mapped_bytes_)));
  address_ = address;
  CUmemAccessDesc access{};
  access.location.type = CU_MEM_LOCATION_TYPE_DEVICE;
  access.location.id = device;
  access.flags = writable() ? CU_MEM_ACCESS_FLAGS_PROT_READWRITE : CU_MEM_ACCESS_FLAGS_PROT_READ;
  driver.check(driver.set_access(address_, mapped_bytes_, &access, 1), in_slab(name(), "giving access to it"));
  data_ = reinterpret_cast<std::byte*>(address_);  // NOLINT(performance-no-int-to-ptr): a number to the driver
}

void CudaSlab::clear() {
  check_runtime(cudaMemsetAsync(data_, 0, mapped_bytes_, cudaStreamPerThread), name(), "clearing it");
  check_runtime(cudaStreamSynchronize(cudaStreamPerThread), name(), "clearing it");
}

std::shared_ptr<CudaSlab> CudaSlab::create(const SlabDescriptor& descriptor, bool shared) {
  (void)slab_data_bytes(descriptor);  // throws when a size is beyond what is allowed
  const Driver& driver = driver_for(descriptor.name);
  auto slab = std::shared_ptr<CudaSlab>(new CudaSlab(descriptor, ControlBlock::create(descriptor, shared), true));
  const CUmemAllocationProp properties = allocation_properties();
  const std::size_t bytes = allocation_bytes(driver, descriptor);
  driver.check(driver.create(&slab->allocation_, bytes, &properties, 0),
               in_slab(descriptor.name, fmt::format("allocating {} bytes on the device", bytes)));
  slab->data_fd_ = export_allocation(driver, slab->allocation_, descriptor.name);
  slab->map_allocation();
  slab->clear();
  return slab;
}

std::shared_ptr<CudaSlab> CudaSlab::map(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                        bool writable) {
  (void)slab_data_bytes(descriptor);
  const Driver& driver = driver_for(descriptor.name);
  auto slab = std::shared_ptr<CudaSlab>(
      new CudaSlab(descriptor, ControlBlock::map(descriptor, std::move(control), writable), writable));
  slab->data_fd_ = std::move(data);
  // The driver takes the descriptor's number in the pointer itself, and leaves the descriptor ours.
  const auto number = static_cast<std::intptr_t>(slab->data_fd());
  void* handle = reinterpret_cast<void*>(number);  // NOLINT(performance-no-int-to-ptr)
  driver.check(driver.import_handle(&slab->allocation_, handle, handle_type),
               in_slab(descriptor.name, "its data descriptor is not CUDA memory"));
  CUmemAllocationProp properties{};
  driver.check(driver.properties(&properties, slab->allocation_), in_slab(descriptor.name, "asking where it lies"));
  if (properties.location.type != CU_MEM_LOCATION_TYPE_DEVICE || properties.location.id != device) {
    throw Error(in_slab(descriptor.name, "its memory is not that of this process's first device"));
  }
  slab->map_allocation();
  return slab;
}

CudaSlab::~CudaSlab() {
  if (allocation_ == 0) return;
  try {
    const Driver& driver = Driver::get();
    if (address_ != 0) {
      cudaDeviceSynchronize();
      driver.unmap(address_, mapped_bytes_);
      driver.free_address(address_, mapped_bytes_);
    }
    driver.release(allocation_);
  } catch (const Error&) {
    // The device is gone, and the memory with it.
    return;
  }
}

void CudaSlab::read(std::size_t offset, std::size_t bytes, void* destination) const {
  if (bytes == 0) return;
  // Any thread may read, the broker's among them. The thread's own stream waits for no kernels of others.
  driver_for(name());
  check_runtime(cudaMemcpyAsync(destination, data_ + offset, bytes, cudaMemcpyDeviceToHost, cudaStreamPerThread),
                name(), "reading it");
  check_runtime(cudaStreamSynchronize(cudaStreamPerThread), name(), "reading it");
}

}  // namespace splatbus::bus::gpu
