#include "bus/slab_memory.h"

#include <fmt/format.h>
#include <sys/mman.h>

#include <cstring>
#include <utility>

#include "bus/error.h"
#include "bus/file_descriptor.h"
#ifdef SPLATBUS_HAVE_CUDA
#include "bus/gpu/cuda_slab.h"
#endif

namespace splatbus::bus {
namespace {

/// How slabs of one kind are made and mapped.
struct SlabMemory {
  Device kind;
  std::shared_ptr<Slab> (*create)(const SlabDescriptor& descriptor, bool shared);
  std::shared_ptr<Slab> (*map)(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                               bool writable);
};

template <class KindOfSlab>
constexpr SlabMemory slab_memory(Device kind) {
  return {kind,
          [](const SlabDescriptor& descriptor, bool shared) -> std::shared_ptr<Slab> {
            return KindOfSlab::create(descriptor, shared);
          },
          [](const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
             bool writable) -> std::shared_ptr<Slab> {
            return KindOfSlab::map(descriptor, std::move(control), std::move(data), writable);
          }};
}

constexpr SlabMemory slab_memories[] = {
    slab_memory<HostSlab>(Device::Cpu),
#ifdef SPLATBUS_HAVE_CUDA
    slab_memory<gpu::CudaSlab>(Device::Cuda),
#endif
};

const SlabMemory& memory_of(const SlabDescriptor& descriptor) {
  for (const SlabMemory& memory : slab_memories) {
    if (memory.kind == descriptor.kind) return memory;
  }
  throw Error(fmt::format("slab '{}': this build has no memory of kind {}", descriptor.name,
                          static_cast<std::uint32_t>(descriptor.kind)));
}

}  // namespace

HostSlab::HostSlab(const SlabDescriptor& descriptor, ControlBlock control, FileDescriptor data, bool writable)
    : Slab(descriptor, std::move(control), writable), data_fd_(std::move(data)) {
  const std::size_t bytes = slab_data_bytes(descriptor);
  data_ = map_memory(data_fd_, bytes, writable, descriptor.name);
  mapped_bytes_ = bytes;
}

HostSlab::~HostSlab() {
  if (data_ != nullptr) ::munmap(data_, mapped_bytes_);
}

std::shared_ptr<HostSlab> HostSlab::create(const SlabDescriptor& descriptor, bool shared) {
  const std::size_t bytes = slab_data_bytes(descriptor);
  auto control = ControlBlock::create(descriptor, shared);
  FileDescriptor data = make_sealed_memfd(descriptor.name, bytes);
  return std::shared_ptr<HostSlab>(new HostSlab(descriptor, std::move(control), std::move(data), true));
}

std::shared_ptr<HostSlab> HostSlab::map(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                        bool writable) {
  const std::size_t bytes = slab_data_bytes(descriptor);
  auto control_block = ControlBlock::map(descriptor, std::move(control), writable);
  require_sealed_memfd(data, bytes, fmt::format("slab '{}': its data", descriptor.name));
  return std::shared_ptr<HostSlab>(new HostSlab(descriptor, std::move(control_block), std::move(data), writable));
}

void HostSlab::read(std::size_t offset, std::size_t bytes, void* destination) const {
  if (bytes > 0) std::memcpy(destination, data_ + offset, bytes);
}

std::shared_ptr<Slab> create_slab_memory(const SlabDescriptor& descriptor, bool shared) {
  return memory_of(descriptor).create(descriptor, shared);
}

std::shared_ptr<Slab> map_slab_memory(const SlabDescriptor& descriptor, FileDescriptor control, FileDescriptor data,
                                      bool writable) {
  return memory_of(descriptor).map(descriptor, std::move(control), std::move(data), writable);
}

}  // namespace splatbus::bus
