#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/slab.h"
#include "bus/tensor.h"

namespace splatbus::bus {

/// An array that is to be published as a tensor: tensor_bytes(shape, type) bytes at `data`, written to the end before
/// TensorRing::write() is called (a stream that wrote it has been waited for).
struct TensorSource {
  std::string name;
  std::vector<std::uint32_t> shape;
  ElementType type = ElementType::F32;
  const void* data = nullptr;
  Device memory = Device::Cpu;  ///< of `data`
};

/// A ring of slots for messages that carry several arrays of varying size: each write() takes the next slot. Not
/// thread-safe.
class TensorRing {
 public:
  /// The slab "<source>/<role>" is made at the first write, with slots of at least `slot_bytes`. When a message does
  /// not fit, it is made again, larger; messages that were not read by then are lost, so say what is to be expected.
  /// `kind` is where the slab lies, whatever the sources' memory.
  TensorRing(std::shared_ptr<Context> context, std::string role, std::size_t slots, std::size_t slot_bytes = 0,
             Device kind = Device::Cpu);

  /// Copies the arrays into the next slot, each aligned to 64 bytes. Throws Error when the slab cannot be made.
  [[nodiscard]] std::vector<OutgoingTensor> write(std::span<const TensorSource> sources);

 private:
  std::shared_ptr<Context> context_;
  std::string role_;
  std::size_t slots_, slot_bytes_;
  Device kind_;
  std::shared_ptr<Slab> slab_;
};

}  // namespace splatbus::bus
