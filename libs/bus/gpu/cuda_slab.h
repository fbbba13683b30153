#pragma once

#include <cuda.h>

#include <memory>

#include "bus/slab.h"

namespace splatbus::bus::gpu {

/// A slab whose data is memory of the first CUDA device: a virtual-memory allocation (cuMemCreate) exported as a POSIX
/// descriptor. It lives as long as anyone holds that descriptor or a mapping, its maker's death notwithstanding.
/// slot_data() is a device address, readable by kernels of every process that maps it.
///
/// The sequence counters are the host's. So a writer begins a write before it launches what writes, and waits for its
/// stream before it ends it; a reader waits for its stream before it asks whether the slot still holds what it read.
class CudaSlab final : public Slab {
 public:
  /// Zeroed memory. Throws Error naming the slab when there is no usable device or too little memory.
  static std::shared_ptr<CudaSlab> create(const SlabDescriptor& descriptor, bool shared);
  /// Throws Error naming the slab when the descriptor is no CUDA allocation, lies on another device, or is smaller than
  /// the slab claims.
  static std::shared_ptr<CudaSlab> map(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                       bool writable);
  /// Waits for all that the device was given by this process: kernels may still read the slab.
  ~CudaSlab() override;
  CudaSlab(const CudaSlab&) = delete;
  CudaSlab& operator=(const CudaSlab&) = delete;

  [[nodiscard]] int data_fd() const override { return data_fd_.get(); }

 private:
  CudaSlab(const SlabDescriptor& descriptor, ControlBlock control, bool writable);
  void map_allocation();
  void clear();
  void read(std::size_t offset, std::size_t bytes, void* destination) const override;

  FileDescriptor data_fd_;
  CUmemGenericAllocationHandle allocation_ = 0;
  CUdeviceptr address_ = 0;  // 0 unless the allocation is mapped there
  std::size_t mapped_bytes_ = 0;
};

}  // namespace splatbus::bus::gpu
