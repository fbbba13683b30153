#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "bus/slab.h"
#include "bus/subscriber.h"
#include "gaussians/model.h"

namespace splatbus {

/// A reader's hold on the trainer's live model, made from a model/published message. Where the planes lie in the kind
/// of memory that is asked for, they are read in place, and the memory stays mapped while this lives: values change
/// while they are read (harmless). Elsewhere they are copied, and refresh() copies them again. The structure is whole
/// only while still_valid(): check it after reading and throw the result away when it is false (a newer model/published
/// is then on its way). Not thread-safe.
class PublishedModel {
 public:
  /// Planes that the caller has no use for need not be copied.
  enum class Need { Both, Average };

  /// Nullopt when the slab is gone or its structure has moved on since. Throws bus::Error when the message lies (planes
  /// of other sizes than count and capacity say, or not all in one slot of one slab; that values are finite is not
  /// checked).
  [[nodiscard]] static std::optional<PublishedModel> open(const bus::Message& message,
                                                          Device kind = Device::Cpu,
                                                          Need need = Need::Both);

  /// Brings copied planes up to date; false when the structure has moved on. Planes that are read in place always are.
  [[nodiscard]] bool refresh();

  [[nodiscard]] std::uint64_t generation() const { return generation_; }
  [[nodiscard]] std::uint64_t step() const { return step_; }
  /// The parameters as the optimizer has them now; no parameters under Need::Average.
  [[nodiscard]] const GaussiansView& live() const { return live_; }
  /// Averaged over time: what is shown and streamed.
  [[nodiscard]] const GaussiansView& average() const { return average_; }
  [[nodiscard]] bool still_valid() const;
  /// Bytes that open() and refresh() have copied out of, or into, device memory.
  [[nodiscard]] std::uint64_t copied_bytes() const { return copied_bytes_; }

 private:
  struct Plane {
    bus::TensorView source;
    std::size_t channels = 1;
    std::size_t element_bytes = 4;
    std::size_t copied_at = 0;  // offset in copies_
  };

  std::uint64_t generation_ = 0, step_ = 0, copied_bytes_ = 0;
  GaussiansView live_, average_;
  std::vector<Plane> planes_;
  Device kind_ = Device::Cpu;
  std::shared_ptr<std::byte> copies_;  // null when planes are read in place
};

}  // namespace splatbus
