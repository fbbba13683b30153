#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "device/stream.h"
#include "trainer/training_view.h"

namespace splatbus::trainer {

/// Of the surfaces that two pictures show of the same scene state: how many lie where the other could see them, and how
/// many of those it sees through.
struct SeenThrough {
  std::uint32_t judged = 0, through = 0;

  /// Whether something solid has come or gone between the two, larger than what edges and rounding come to.
  [[nodiscard]] bool differs() const {
    return through >= kLeast && through >= kLeastShare * static_cast<float>(judged);
  }

  static constexpr std::uint32_t kLeast = 8;
  static constexpr float kLeastShare = 0.005F;
};

/// Of `newer` and each of `kept`, in both directions, by a sixteenth of their pixels. All have depth and lie in memory
/// of the stream's device. Pixels that a view masks say nothing.
[[nodiscard]] std::vector<SeenThrough> seen_through(device::StreamView stream, const TrainingView& newer,
                                                    std::span<const TrainingViewPtr> kept);

}  // namespace splatbus::trainer
