#include "bus/slab_range.h"

#include <fmt/format.h>
#include <sys/mman.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "bus/error.h"
#ifdef SPLATBUS_HAVE_CUDA
#include <cuda_runtime_api.h>

#include "bus/gpu/cuda_driver.h"
#endif

namespace splatbus::bus {

SlabRange::SlabRange(Device device, std::size_t max_bytes) : device_(device), reserved_(max_bytes) {
  reserve();
}

SlabRange::~SlabRange() {
  release();
}

void SlabRange::append(std::shared_ptr<const Slab> slab) {
  const auto refuse = [&](const std::string& why) {
    throw Error(fmt::format("slab '{}': cannot follow others: {}", slab->name(), why));
  };
  const std::size_t slab_bytes = slab_data_bytes(slab->descriptor());
  if (slab->descriptor().kind != device_) refuse(fmt::format("its memory is not that of {}", name_of(device_)));
  if (slab_bytes % granularity_ != 0)
    refuse(fmt::format("{} bytes are not a multiple of {}", slab_bytes, granularity_));
  if (slab_bytes > reserved_ - bytes_) {
    refuse(fmt::format("{} bytes are reserved, {} taken", reserved_, bytes_));
  }
  slabs_.reserve(slabs_.size() + 1);
  map(*slab, slab_bytes);
  slabs_.push_back(std::move(slab));
  bytes_ += slab_bytes;
}

#ifdef SPLATBUS_HAVE_CUDA

namespace {

constexpr CUmemAllocationHandleType kHandleType = CU_MEM_HANDLE_TYPE_POSIX_FILE_DESCRIPTOR;
constexpr std::size_t kCudaGranularity = std::size_t{2} << 20U;

CUdeviceptr address_of(const std::byte* data) {
  return reinterpret_cast<CUdeviceptr>(data);
}

}  // namespace

#endif

void SlabRange::reserve() {
#ifdef SPLATBUS_HAVE_CUDA
  if (device_ == Device::Cuda) {
    const gpu::Driver& driver = gpu::Driver::get();
    granularity_ = kCudaGranularity;
    reserved_ = (reserved_ + granularity_ - 1) / granularity_ * granularity_;
    CUdeviceptr address = 0;
    driver.check(driver.reserve(&address, reserved_, 0, 0, 0), fmt::format("reserving {} addresses", reserved_));
    data_ = reinterpret_cast<std::byte*>(address);  // NOLINT(performance-no-int-to-ptr): a number to the driver
    return;
  }
#endif
  if (device_ != Device::Cpu) throw Error("this build has no CUDA memory");
  void* const addresses = ::mmap(nullptr, reserved_, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (addresses == MAP_FAILED) throw Error(fmt::format("reserving {} addresses: {}", reserved_, std::strerror(errno)));
  data_ = static_cast<std::byte*>(addresses);
}

void SlabRange::map(const Slab& slab, std::size_t slab_bytes) {
#ifdef SPLATBUS_HAVE_CUDA
  if (device_ == Device::Cuda) {
    const gpu::Driver& driver = gpu::Driver::get();
    const std::string what = fmt::format("slab '{}': mapping it behind others", slab.name());
    allocations_.reserve(allocations_.size() + 1);
    CUmemGenericAllocationHandle allocation = 0;
    // The driver takes the descriptor's number in the pointer itself, and leaves the descriptor ours.
    const auto number = static_cast<std::intptr_t>(slab.data_fd());
    driver.check(driver.import_handle(&allocation, reinterpret_cast<void*>(number), kHandleType), what);  // NOLINT
    const CUdeviceptr address = address_of(data_ + bytes_);
    CUresult result = driver.map(address, slab_bytes, 0, allocation, 0);
    if (result == CUDA_SUCCESS) {
      CUmemAccessDesc access{};
      access.location.type = CU_MEM_LOCATION_TYPE_DEVICE;
      access.flags = slab.writable() ? CU_MEM_ACCESS_FLAGS_PROT_READWRITE : CU_MEM_ACCESS_FLAGS_PROT_READ;
      result = driver.set_access(address, slab_bytes, &access, 1);
      if (result != CUDA_SUCCESS) driver.unmap(address, slab_bytes);
    }
    if (result != CUDA_SUCCESS) driver.release(allocation);
    driver.check(result, what);
    allocations_.push_back(allocation);
    return;
  }
#endif
  const int protection = slab.writable() ? PROT_READ | PROT_WRITE : PROT_READ;
  void* const mapped = ::mmap(data_ + bytes_, slab_bytes, protection, MAP_SHARED | MAP_FIXED, slab.data_fd(), 0);
  if (mapped == MAP_FAILED) {
    throw Error(fmt::format("slab '{}': mapping it behind others: {}", slab.name(), std::strerror(errno)));
  }
}

void SlabRange::release() noexcept {
#ifdef SPLATBUS_HAVE_CUDA
  if (device_ == Device::Cuda) {
    try {
      const gpu::Driver& driver = gpu::Driver::get();
      cudaDeviceSynchronize();
      std::size_t offset = 0;
      for (std::size_t k = 0; k < slabs_.size(); ++k) {
        const std::size_t slab_bytes = slab_data_bytes(slabs_[k]->descriptor());
        driver.unmap(address_of(data_ + offset), slab_bytes);
        driver.release(allocations_[k]);
        offset += slab_bytes;
      }
      driver.free_address(address_of(data_), reserved_);
    } catch (const Error&) {
      return;  // the device is gone, and the memory with it
    }
    return;
  }
#endif
  ::munmap(data_, reserved_);
}

}  // namespace splatbus::bus
