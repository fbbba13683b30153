#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "wire/common_generated.h"

namespace splatbus::bus {

/// Memory shared between processes: a ring of equal slots, each under a sequence lock (odd while it is written).
///
/// A slab is two file descriptors: a small memfd with the control block (magic, sizes, one sequence counter a slot),
/// and the data. `HostSlab` keeps the data in a memfd; a CUDA slab keeps it in an exported VMM allocation and derives
/// from the same class. The bus process holds duplicates of both descriptors, so a slab outlives its maker.
///
/// One process writes a slab, any number read it. A writer never waits for readers. Not thread-safe for several
/// writers; readers may be on any thread.
class Slab {
 public:
  virtual ~Slab() = default;
  Slab(const Slab&) = delete;
  Slab& operator=(const Slab&) = delete;

  [[nodiscard]] std::uint64_t id() const { return id_; }
  [[nodiscard]] const std::string& name() const { return name_; }
  [[nodiscard]] std::size_t slots() const;
  [[nodiscard]] std::size_t slot_bytes() const;

  /// Start of a slot's data: a host address for HostSlab, a device address for a CUDA slab. Aligned to 4096 bytes.
  [[nodiscard]] std::byte* slot_data(std::size_t slot) const;

  /// Sequence value of a slot now; odd while it is being written.
  [[nodiscard]] std::uint64_t sequence(std::size_t slot) const;

  /// Marks the slot as being written: readers of its old content see that it is gone. A slot that a killed writer left
  /// odd is taken over.
  void begin_write(std::size_t slot);
  /// Ends the write; returns the new generation, an even number greater than any before.
  std::uint64_t end_write(std::size_t slot);

  /// The next slot of the ring, begun; commit() ends it. For the usual producer of frames.
  std::size_t next_slot();

  /// A span of a slot's bytes under the generation `end_write` returned, to be put into a message.
  [[nodiscard]] wire::Span span(std::size_t slot, std::size_t offset_in_slot, std::size_t bytes,
                                std::uint64_t generation) const;

  /// Address of the slot's sequence counter (std::atomic<uint64_t>), for TensorView.
  [[nodiscard]] const void* sequence_address(std::size_t slot) const;

 protected:
  Slab() = default;
  std::uint64_t id_ = 0;
  std::string name_;
  std::byte* control_ = nullptr;
  std::byte* data_ = nullptr;

 private:
  std::size_t next_ = 0;
};

}  // namespace splatbus::bus
