#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "bus/file_descriptor.h"
#include "device/device.h"
#include "wire/common_generated.h"

namespace splatbus::bus {

/// What a slab claims to be; every claim is checked against the descriptors that come with it.
struct SlabDescriptor {
  std::uint64_t id = 0;  ///< made by the owner, unique for ever: it survives a restart of the broker
  std::string name;      ///< "<source>/<role>"
  Device kind = Device::Cpu;
  std::size_t slots = 0;
  std::size_t slot_bytes = 0;
  bool kept = false;  ///< for a successor: stays when its maker is gone
};

/// Bytes from one slot's start to the next: slot_bytes rounded up to 4096.
[[nodiscard]] std::size_t slot_stride(const SlabDescriptor& descriptor);

/// The longest name that a slab can have.
constexpr std::size_t max_slab_name = 191;

/// Bytes of the whole data. Throws Error naming the slab when its name is empty or too long, or a size is 0 or beyond
/// what libs/bus allows (65536 slots, 64 GiB).
[[nodiscard]] std::size_t slab_data_bytes(const SlabDescriptor& descriptor);

/// The small memfd beside a slab's data: magic, sizes and one sequence counter a slot. Layout: docs/protocol.md.
class ControlBlock {
 public:
  /// A new one, sealed against resizing; private memory without a descriptor when not `shared`. Throws Error.
  static ControlBlock create(const SlabDescriptor& descriptor, bool shared);
  /// Maps what a peer sent. Throws Error when it is not a control block of that very slab.
  static ControlBlock map(const SlabDescriptor& descriptor, FileDescriptor fd, bool writable);

  ControlBlock(ControlBlock&& other) noexcept;
  ControlBlock& operator=(ControlBlock&&) = delete;
  ~ControlBlock();

  [[nodiscard]] int fd() const { return fd_.get(); }
  [[nodiscard]] const void* sequence_address(std::size_t slot) const;
  [[nodiscard]] void* sequence_address(std::size_t slot);

 private:
  ControlBlock() = default;
  FileDescriptor fd_;
  std::byte* mapping_ = nullptr;
  std::size_t bytes_ = 0;
};

/// Memory shared between processes: a ring of equal slots, each under a sequence lock (odd while it is written).
///
/// A slab is two file descriptors: a control block, and the data. `HostSlab` keeps the data in a memfd; a CUDA slab
/// keeps it in an exported VMM allocation and derives from the same class (bus/slab_memory.h maps a kind to its class).
/// The bus process holds duplicates of both descriptors, so a slab outlives its maker.
///
/// One process writes a slab, any number read it. A writer never waits for readers. Not thread-safe for several
/// writers; readers may be on any thread.
class Slab {
 public:
  virtual ~Slab() = default;
  Slab(const Slab&) = delete;
  Slab& operator=(const Slab&) = delete;

  [[nodiscard]] std::uint64_t id() const { return descriptor_.id; }
  [[nodiscard]] const std::string& name() const { return descriptor_.name; }
  [[nodiscard]] const SlabDescriptor& descriptor() const { return descriptor_; }
  [[nodiscard]] std::size_t slots() const { return descriptor_.slots; }
  [[nodiscard]] std::size_t slot_bytes() const { return descriptor_.slot_bytes; }
  [[nodiscard]] bool writable() const { return writable_; }

  /// Start of a slot's data: a host address for HostSlab, a device address for a CUDA slab. Aligned to 4096 bytes.
  /// Writing through it needs a slab that is writable().
  [[nodiscard]] std::byte* slot_data(std::size_t slot) const;

  /// Sequence value of a slot now; odd while it is being written.
  [[nodiscard]] std::uint64_t sequence(std::size_t slot) const;

  /// Marks the slot as being written: readers of its old content see that it is gone. A slot that a killed writer left
  /// odd is taken over. Throws Error when the slab is mapped read-only.
  void begin_write(std::size_t slot);
  /// Ends the write; returns the new generation, an even number greater than any before.
  std::uint64_t end_write(std::size_t slot);

  /// The next slot of the ring, begun; end_write() ends it. For the usual producer of frames.
  std::size_t next_slot();

  /// A span of a slot's bytes under the generation `end_write` returned, to be put into a message. Throws Error when
  /// it does not lie within the slot.
  [[nodiscard]] wire::Span span(std::size_t slot, std::size_t offset_in_slot, std::size_t bytes,
                                std::uint64_t generation) const;

  /// The slot that a span from a peer lies in. Throws Error naming the slab when the span leaves its slot.
  [[nodiscard]] std::size_t slot_of(const wire::Span& span) const;

  /// Where a span from a peer begins. Throws Error as slot_of does.
  [[nodiscard]] const std::byte* data_of(const wire::Span& span) const;

  /// True while the span's slot still holds what it held under the span's generation; whatever was read before this
  /// call was then whole. The span lies within its slot.
  [[nodiscard]] bool holds(const wire::Span& span) const;

  /// Copies a span to host memory (span.bytes() of room). False when its slot was overwritten, before or meanwhile; the
  /// destination then holds garbage. Throws Error as slot_of does.
  [[nodiscard]] bool copy(const wire::Span& span, void* destination) const;

  /// Descriptors for the registry and for who maps the data once more, owned by the slab; the control block of a slab
  /// that is private to this process has none (-1).
  [[nodiscard]] int control_fd() const { return control_.fd(); }
  [[nodiscard]] virtual int data_fd() const = 0;

 protected:
  Slab(SlabDescriptor descriptor, ControlBlock control, bool writable);

  /// Copies from the data's start + offset to host memory; the range was checked.
  virtual void read(std::size_t offset, std::size_t bytes, void* destination) const = 0;

  std::byte* data_ = nullptr;  ///< set by the derived class

 private:
  const SlabDescriptor descriptor_;  // a copy: a peer may scribble over the control block at any time
  const std::size_t stride_;
  ControlBlock control_;
  const bool writable_;
  std::size_t next_ = 0;
};

}  // namespace splatbus::bus
