#pragma once

#include <cstddef>
#include <cstdint>

#include "bus/parameters.h"
#include "expander/gaussian_inserter.h"
#include "expander/retransmit_queue.h"
#include "wire/model_limits.h"

namespace splatbus::expander {

/// The expander's parameters. What bounds its memory is fixed at the start.
struct Options {
  float cell_size_m = 0.25F;
  std::size_t max_samples = std::size_t{4} << 20, max_cells = std::size_t{1} << 20;
  InsertOptions insert;  ///< without room
  RetransmitQueue::Options queue;
  std::size_t max_gaussians = kDefaultMaxGaussians;
  double adopt_wait_s = 3, refresh_s = 2, resend_s = 1;
  double ahead_s = 3, repeat_s = 1;
  /// From this pace of the optimizer on cells are filled as densely as insert.select says.
  double fill_steps_per_s = 20;

  /// What a round is inserted by while the optimizer takes so many steps a second; 0: nobody knows. Gaussians that it
  /// has no time to train cost more steps than they are worth: as many fewer of them fill a surface as it is slower.
  [[nodiscard]] InsertOptions insert_at(double steps_per_s) const;

  void bind(bus::ParameterBinder& parameters);
};

}  // namespace splatbus::expander
