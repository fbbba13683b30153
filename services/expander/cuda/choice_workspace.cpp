#include "expander/cuda/choice_workspace.h"

namespace splatbus::expander::cuda {

ChoiceWorkspace::ChoiceWorkspace(Pool& pool)
    : cells(pool), pool_(&pool), counts_(pool.take(2 * sizeof(std::uint32_t), "counts of samples")) {
  unseen_ = reinterpret_cast<std::uint32_t*>(counts_.get());
  choice_.count = unseen_ + 1;
}

void ChoiceWorkspace::lay_out(Carver& carver, std::uint32_t n) {
  placement_.key = carver.take<std::uint64_t>(n);
  for (float3** vectors : {&placement_.position, &placement_.normal}) *vectors = carver.take<float3>(n);
  choice_.apart = carver.take<float>(n);
  for (std::uint32_t** counts :
       {&choice_.modelled, &choice_.fresh, &choice_.inserted, &choice_.cell_of, &choice_.chosen}) {
    *counts = carver.take<std::uint32_t>(n);
  }
  for (std::uint8_t** flags : {&choice_.uncovered, &choice_.taken}) *flags = carver.take<std::uint8_t>(n);
  scratch_ = carver.take<std::byte>(scratch_bytes_);
}

void ChoiceWorkspace::resize(std::uint32_t n) {
  const std::size_t scratch_bytes = choose_scratch_bytes(n);
  if (n <= room_ && scratch_bytes <= scratch_bytes_) return;
  memory_.reset();
  room_ = 0;
  scratch_bytes_ = scratch_bytes;
  memory_ = carve(*pool_, "choosing among samples", [&](Carver& carver) { lay_out(carver, n); });
  room_ = n;
}

}  // namespace splatbus::expander::cuda
