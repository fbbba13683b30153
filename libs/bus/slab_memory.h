#pragma once

#include <memory>

#include "bus/slab.h"

namespace splatbus::bus {

/// A slab whose data is host memory: a memfd sealed against resizing, or private memory of this process.
class HostSlab final : public Slab {
 public:
  static std::shared_ptr<HostSlab> create(const SlabDescriptor& descriptor, bool shared);
  static std::shared_ptr<HostSlab> map(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                       bool writable);
  ~HostSlab() override;
  HostSlab(const HostSlab&) = delete;
  HostSlab& operator=(const HostSlab&) = delete;

  [[nodiscard]] int data_fd() const override { return data_fd_.get(); }

 private:
  HostSlab(const SlabDescriptor& descriptor, ControlBlock control, FileDescriptor data, bool writable);
  void read(std::size_t offset, std::size_t bytes, void* destination) const override;

  FileDescriptor data_fd_;
  std::size_t mapped_bytes_ = 0;
};

/// Makes the slab that `descriptor.kind` names. Throws Error, also for a kind that this build has no memory for.
std::shared_ptr<Slab> create_slab_memory(const SlabDescriptor& descriptor, bool shared);

/// Maps the slab that a peer sent. Throws Error naming the slab when the descriptors hold less than it claims, or could
/// be shrunk under us.
std::shared_ptr<Slab> map_slab_memory(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                      bool writable);

}  // namespace splatbus::bus
