#include "bus/slab.h"

#include <fmt/format.h>
#include <sys/mman.h>

#include <atomic>
#include <cassert>
#include <cerrno>
#include <cstring>
#include <utility>

#include "bus/error.h"
#include "bus/file_descriptor.h"

namespace splatbus::bus {

#if defined(__SANITIZE_THREAD__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wtsan"  // ThreadSanitizer does not model fences; what they order crosses processes
#endif

inline void acquire_fence() {
  std::atomic_thread_fence(std::memory_order_acquire);
}
inline void release_fence() {
  std::atomic_thread_fence(std::memory_order_release);
}

#if defined(__SANITIZE_THREAD__)
#pragma GCC diagnostic pop
#endif
namespace {

constexpr std::uint64_t control_magic = 0x3142534c53554253;  // "SBUSLSB1"
constexpr std::uint32_t control_version = 1;
constexpr std::size_t page_bytes = 4096;
constexpr std::size_t max_slots = 65536;
constexpr std::size_t max_data_bytes = std::size_t{1} << 36;

struct ControlHeader {
  std::uint64_t magic;
  std::uint32_t version;
  std::uint32_t kind;
  std::uint64_t id;
  std::uint64_t slots;
  std::uint64_t slot_bytes;
  std::uint64_t reserved[3];
};
static_assert(sizeof(ControlHeader) == 64);

using Sequence = std::atomic<std::uint64_t>;
static_assert(sizeof(Sequence) == 8 && Sequence::is_always_lock_free, "sequence counters are shared between processes");

std::size_t control_bytes(const SlabDescriptor& descriptor) {
  return sizeof(ControlHeader) + descriptor.slots * sizeof(Sequence);
}

}  // namespace

std::size_t slot_stride(const SlabDescriptor& descriptor) {
  return (descriptor.slot_bytes + page_bytes - 1) / page_bytes * page_bytes;
}

std::size_t slab_data_bytes(const SlabDescriptor& descriptor) {
  if (descriptor.name.empty() || descriptor.name.size() > max_slab_name) {
    throw Error(fmt::format("slab '{}...': its name has {} characters; allowed are 1 to {}",
                            descriptor.name.substr(0, 64), descriptor.name.size(), max_slab_name));
  }
  if (descriptor.slots == 0 || descriptor.slots > max_slots || descriptor.slot_bytes == 0 ||
      descriptor.slot_bytes > max_data_bytes || slot_stride(descriptor) > max_data_bytes / descriptor.slots) {
    throw Error(fmt::format("slab '{}': {} slots of {} bytes; allowed are 1 to {} slots and {} bytes in all",
                            descriptor.name, descriptor.slots, descriptor.slot_bytes, max_slots, max_data_bytes));
  }
  return descriptor.slots * slot_stride(descriptor);
}

ControlBlock ControlBlock::create(const SlabDescriptor& descriptor, bool shared) {
  ControlBlock block;
  block.bytes_ = control_bytes(descriptor);
  if (shared) block.fd_ = make_sealed_memfd(descriptor.name + " control", block.bytes_);
  block.mapping_ = map_memory(block.fd_, block.bytes_, true, descriptor.name);
  const ControlHeader header{control_magic, control_version,  static_cast<std::uint32_t>(descriptor.kind),
                             descriptor.id, descriptor.slots, descriptor.slot_bytes,
                             {0, 0, 0}};
  std::memcpy(block.mapping_, &header, sizeof(header));
  return block;
}

ControlBlock ControlBlock::map(const SlabDescriptor& descriptor, FileDescriptor fd, bool writable) {
  ControlBlock block;
  block.bytes_ = control_bytes(descriptor);
  require_sealed_memfd(fd, block.bytes_, fmt::format("slab '{}': its control block", descriptor.name));
  block.fd_ = std::move(fd);
  block.mapping_ = map_memory(block.fd_, block.bytes_, writable, descriptor.name);
  ControlHeader header{};
  std::memcpy(&header, block.mapping_, sizeof(header));
  if (header.magic != control_magic || header.version != control_version) {
    throw Error(fmt::format("slab '{}': its control block is not one of version {}", descriptor.name, control_version));
  }
  if (header.id != descriptor.id || header.slots != descriptor.slots || header.slot_bytes != descriptor.slot_bytes ||
      header.kind != static_cast<std::uint32_t>(descriptor.kind)) {
    throw Error(
        fmt::format("slab '{}': its control block says slab {:#x} with {} slots of {} bytes, the registry "
                    "slab {:#x} with {} slots of {} bytes",
                    descriptor.name, header.id, header.slots, header.slot_bytes, descriptor.id, descriptor.slots,
                    descriptor.slot_bytes));
  }
  return block;
}

ControlBlock::ControlBlock(ControlBlock&& other) noexcept
    : fd_(std::move(other.fd_)), mapping_(std::exchange(other.mapping_, nullptr)), bytes_(other.bytes_) {}

ControlBlock::~ControlBlock() {
  if (mapping_ != nullptr) ::munmap(mapping_, bytes_);
}

const void* ControlBlock::sequence_address(std::size_t slot) const {
  return mapping_ + sizeof(ControlHeader) + slot * sizeof(Sequence);
}

void* ControlBlock::sequence_address(std::size_t slot) {
  return mapping_ + sizeof(ControlHeader) + slot * sizeof(Sequence);
}

Slab::Slab(SlabDescriptor descriptor, ControlBlock control, bool writable)
    : descriptor_(std::move(descriptor)),
      stride_(slot_stride(descriptor_)),
      control_(std::move(control)),
      writable_(writable) {}

std::byte* Slab::slot_data(std::size_t slot) const {
  assert(slot < slots());
  return data_ + slot * stride_;
}

std::uint64_t Slab::sequence(std::size_t slot) const {
  assert(slot < slots());
  return static_cast<const Sequence*>(control_.sequence_address(slot))->load(std::memory_order_acquire);
}

void Slab::begin_write(std::size_t slot) {
  assert(slot < slots());
  if (!writable_) throw Error(fmt::format("slab '{}' is mapped read-only", name()));
  auto* counter = static_cast<Sequence*>(control_.sequence_address(slot));
  const std::uint64_t before = counter->load(std::memory_order_relaxed);
  counter->store(before % 2 == 0 ? before + 1 : before + 2, std::memory_order_relaxed);
  // Keeps the writes of the data from rising above the odd mark.
  release_fence();
}

std::uint64_t Slab::end_write(std::size_t slot) {
  assert(slot < slots() && writable_);
  auto* counter = static_cast<Sequence*>(control_.sequence_address(slot));
  const std::uint64_t written = counter->load(std::memory_order_relaxed);
  const std::uint64_t generation = written % 2 == 1 ? written + 1 : written + 2;  // even, whoever wrote beside us
  counter->store(generation, std::memory_order_release);
  return generation;
}

std::size_t Slab::next_slot() {
  const std::size_t slot = next_;
  next_ = (next_ + 1) % slots();
  begin_write(slot);
  return slot;
}

wire::Span Slab::span(std::size_t slot, std::size_t offset_in_slot, std::size_t bytes, std::uint64_t generation) const {
  const wire::Span result(id(), generation, slot * stride_ + offset_in_slot, bytes, wire::Storage::Slab);
  if (offset_in_slot > slot_bytes() || slot_of(result) != slot) {
    throw Error(fmt::format("slab '{}': span at {} leaves slot {}", name(), offset_in_slot, slot));
  }
  return result;
}

std::size_t Slab::slot_of(const wire::Span& span) const {
  const std::uint64_t slot = span.offset() / stride_;
  const std::uint64_t start = span.offset() % stride_;
  if (slot >= slots() || start > slot_bytes() || span.bytes() > slot_bytes() - start) {
    throw Error(fmt::format("slab '{}': {} bytes at {} leave their slot ({} slots of {} bytes)", name(), span.bytes(),
                            span.offset(), slots(), slot_bytes()));
  }
  return slot;
}

const std::byte* Slab::data_of(const wire::Span& span) const {
  (void)slot_of(span);  // throws when the span leaves its slot
  return data_ + span.offset();
}

bool Slab::holds(const wire::Span& span) const {
  if (span.generation() % 2 != 0) return false;
  // The fence keeps the reads of the data that came before from sinking below the check (Boehm 2012, seqlock readers).
  acquire_fence();
  const auto* counter = static_cast<const Sequence*>(control_.sequence_address(span.offset() / stride_));
  return counter->load(std::memory_order_relaxed) == span.generation();
}

bool Slab::copy(const wire::Span& span, void* destination) const {
  const std::size_t slot = slot_of(span);
  if (span.generation() % 2 != 0 || sequence(slot) != span.generation()) return false;
  read(span.offset(), span.bytes(), destination);
  return holds(span);
}

}  // namespace splatbus::bus
