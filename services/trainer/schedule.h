#pragma once

#include <cstdint>
#include <optional>
#include <random>
#include <vector>

#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Which views are trained when: epochs over the reference cameras, each in an order of its own, and one input camera
/// after every `input_interval` reference views (docs/decisions/0073-training-defaults.md). Without reference
/// cameras, input cameras only. An input view rests while its light is not the newest one and a reference view has
/// that: input pictures may be rendered once, and the model's visibility of the sun follows the newest light. The same
/// seed, cameras and calls give the same choice.
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
  /// `light` (generation), where given, is the only one whose views are drawn.
  TrainingViewPtr draw(const ViewStore& views, Epoch& epoch, std::optional<std::uint64_t> light = std::nullopt);

  std::mt19937_64 random_;
  Epoch references_{.role = CameraRole::Reference, .left = {}};
  Epoch inputs_{.role = CameraRole::Input, .left = {}};
  int references_since_input_ = 0;
};

}  // namespace splatbus::trainer
