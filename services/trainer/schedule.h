#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Which views are trained when: epochs over the reference cameras, each in an order of its own, and one input camera
/// after every `input_interval` reference views (docs/decisions: input pictures as training views). Without reference
/// cameras, input cameras only. The same seed, cameras and calls give the same choice.
class Schedule {
 public:
  explicit Schedule(std::uint64_t seed);

  /// The next view; null when there is none. `input_interval` 0: no input cameras.
  [[nodiscard]] TrainingViewPtr next(const ViewStore& views, int input_interval);

 private:
  struct Epoch {
    CameraRole role;
    std::vector<ViewKey> left;
  };
  TrainingViewPtr draw(const ViewStore& views, Epoch& epoch);

  std::mt19937_64 random_;
  Epoch references_{.role = CameraRole::Reference, .left = {}};
  Epoch inputs_{.role = CameraRole::Input, .left = {}};
  int references_since_input_ = 0;
};

}  // namespace splatbus::trainer
