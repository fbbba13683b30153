#pragma once

#include <cuda.h>

#include <memory>

#include "bus/slab.h"

namespace splatbus::bus::gpu {

/// A slab whose data is memory of the first CUDA device: a virtual-memory allocation (cuMemCreate) exported as a POSIX
/// descriptor. It lives as long as anyone holds that descriptor or a mapping, its maker's death notwithstanding.
/// slot_data() is a device address, readable by kernels of every process that maps it.
class CudaSlab final : public Slab {
 public:
  /// Throws Error when there is no usable device or too little memory.
  static std::shared_ptr<CudaSlab> create(const SlabDescriptor& descriptor, bool shared);
  /// Throws Error naming the slab when the descriptor is no CUDA allocation, or is smaller than the slab claims.
  static std::shared_ptr<CudaSlab> map(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                       bool writable);
  ~CudaSlab() override;
  CudaSlab(const CudaSlab&) = delete;
  CudaSlab& operator=(const CudaSlab&) = delete;

  [[nodiscard]] int data_fd() const override { return data_fd_.get(); }

 private:
  CudaSlab(const SlabDescriptor& descriptor, ControlBlock control, FileDescriptor data, bool writable);
  void map_allocation(CUmemGenericAllocationHandle allocation, bool writable);
  void read(std::size_t offset, std::size_t bytes, void* destination) const override;

  FileDescriptor data_fd_;
  CUmemGenericAllocationHandle allocation_ = 0;
  CUdeviceptr address_ = 0;
  std::size_t mapped_bytes_ = 0;
};

}  // namespace splatbus::bus::gpu
