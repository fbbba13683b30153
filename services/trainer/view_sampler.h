#pragma once

#include <cstdint>
#include <random>
#include <vector>

#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Which views are trained when: epochs over the reference cameras, each in an order of its own, and one input camera
/// after every `input_interval` reference views (docs/decisions/0073-training-defaults.md). Without reference
/// cameras, input cameras only. A batch of several views is of one kind, for pictures of one size are trained at once;
/// one of input cameras then comes after every `input_interval` batches of reference views. The same seed, cameras and
/// calls give the same choice.
class ViewSampler {
 public:
  explicit ViewSampler(std::uint64_t seed);

  /// The next views, at most `size`; none when there are none. `input_interval` 0: no input cameras.
  [[nodiscard]] std::vector<TrainingViewPtr> next_batch(const ViewStore& views, int size, int input_interval);
  /// A batch of one; null when there is none.
  [[nodiscard]] TrainingViewPtr next(const ViewStore& views, int input_interval);

 private:
  struct Epoch {
    CameraRole role;
    std::vector<ViewKey> left;
  };
  TrainingViewPtr draw(const ViewStore& views, Epoch& epoch);
  std::vector<TrainingViewPtr> draw_batch(const ViewStore& views, int size, Epoch& epoch);

  std::mt19937_64 random_;
  Epoch references_{.role = CameraRole::Reference, .left = {}};
  Epoch inputs_{.role = CameraRole::Input, .left = {}};
  int references_since_input_ = 0;
};

}  // namespace splatbus::trainer
