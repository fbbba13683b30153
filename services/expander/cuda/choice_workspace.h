#pragma once

#include <cstddef>
#include <cstdint>

#include "device/buffer.h"
#include "expander/cuda/cell_table.h"
#include "expander/cuda/kernels.h"

namespace splatbus::expander::cuda {

/// What choosing from a round writes, reused from round to round.
class ChoiceWorkspace {
 public:
  ChoiceWorkspace() : count_(1), unseen_(1) {}

  /// Room for a round of n > 0 samples; what was there before is lost.
  void resize(std::uint32_t n);

  [[nodiscard]] Placement placement() const;
  [[nodiscard]] ChoiceView choice() const;
  [[nodiscard]] std::uint32_t* unseen() const { return unseen_.data(); }
  [[nodiscard]] device::Buffer<std::byte>& scratch() { return scratch_; }

  CellTable cells;

 private:
  device::Buffer<std::uint64_t> key_;
  device::Buffer<float3> position_, normal_;
  device::Buffer<float> apart_;
  device::Buffer<std::uint32_t> modelled_, fresh_, inserted_, cell_of_, chosen_, count_, unseen_;
  device::Buffer<std::uint8_t> uncovered_, taken_;
  device::Buffer<std::byte> scratch_;
};

}  // namespace splatbus::expander::cuda
