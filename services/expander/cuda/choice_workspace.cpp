#include "expander/cuda/choice_workspace.h"

namespace splatbus::expander::cuda {

void ChoiceWorkspace::resize(std::uint32_t n) {
  key_.resize(n);
  for (auto* vectors : {&position_, &normal_}) vectors->resize(n);
  apart_.resize(n);
  for (auto* counts : {&modelled_, &fresh_, &inserted_, &cell_of_, &chosen_}) counts->resize(n);
  for (auto* flags : {&uncovered_, &taken_}) flags->resize(n);
  scratch_.resize(choose_scratch_bytes(n));
}

Placement ChoiceWorkspace::placement() const {
  return {.key = key_.data(), .position = position_.data(), .normal = normal_.data()};
}

ChoiceView ChoiceWorkspace::choice() const {
  return {.apart = apart_.data(),
          .modelled = modelled_.data(),
          .fresh = fresh_.data(),
          .inserted = inserted_.data(),
          .uncovered = uncovered_.data(),
          .taken = taken_.data(),
          .cell_of = cell_of_.data(),
          .chosen = chosen_.data(),
          .count = count_.data()};
}

}  // namespace splatbus::expander::cuda
