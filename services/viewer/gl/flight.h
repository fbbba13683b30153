#pragma once

#include <cstddef>
#include <string>

#include "viewer/gl/stage.h"

namespace splatbus::viewer::gl {

/// Rows of a wavy floor, 10 m along each side, that N Gaussians of a trained scene's sizes cover: for measuring.
[[nodiscard]] SharedBatch wavy_floor(std::size_t gaussians);

/// Rows that change while it flies, as a stream changes them: those of `of`, in turn.
struct FlightChanges {
  SharedBatch of;
  double rows_per_s = 0;
};

struct FlightFigures {
  std::size_t frames = 0;
  std::size_t rows_changed = 0;
  double seconds = 0, frames_per_s = 0;
  double median_ms = 0, p95_ms = 0, p99_ms = 0;  ///< between pictures
  StepTimes device;                              ///< medians
  Drawn drawn;                                   ///< those that count
};

/// Once around a sphere about all, nearer and farther, as the page's ?bench=1: as many pictures as the device gives,
/// into memory of its own, two at a time on their way. The first tenth is not counted.
[[nodiscard]] FlightFigures fly(Stage& stage, const SceneState& scene, const Bounds& bounds, std::uint32_t width,
                                std::uint32_t height, double seconds, const FlightChanges& changes);

}  // namespace splatbus::viewer::gl
