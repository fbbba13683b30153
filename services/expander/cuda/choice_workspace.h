#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "expander/cuda/cell_table.h"
#include "expander/cuda/kernels.h"
#include "expander/cuda/pool.h"

namespace splatbus::expander::cuda {

/// What choosing from a round writes, reused from round to round.
class ChoiceWorkspace {
 public:
  explicit ChoiceWorkspace(Pool& pool);

  /// Room for a round of n > 0 samples; what was there before is lost. Throws std::runtime_error when there is no
  /// memory for it; there is no room then.
  void resize(std::uint32_t n);

  [[nodiscard]] const Placement& placement() const { return placement_; }
  [[nodiscard]] const ChoiceView& choice() const { return choice_; }
  [[nodiscard]] std::uint32_t* unseen() const { return unseen_; }  ///< also without room
  [[nodiscard]] void* scratch() const { return scratch_; }
  [[nodiscard]] std::size_t scratch_bytes() const { return scratch_bytes_; }

  CellTable cells;

 private:
  void lay_out(Carver& carver, std::uint32_t n);

  Pool* pool_;
  std::shared_ptr<std::byte> counts_, memory_;
  Placement placement_{};
  ChoiceView choice_{};
  std::uint32_t* unseen_;
  std::byte* scratch_ = nullptr;
  std::size_t room_ = 0, scratch_bytes_ = 0;
};

}  // namespace splatbus::expander::cuda
