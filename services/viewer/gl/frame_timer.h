#pragma once

#include <array>
#include <cstddef>
#include <optional>

#include "gl/objects.h"

namespace splatbus::viewer::gl {

/// What the steps of a picture cost the device.
struct StepTimes {
  double project_ms = 0, sort_ms = 0, draw_ms = 0;
};

/// Times of pictures, without waiting for any: those that are on their way are kept apart. Of the context that was
/// current when it was made.
class FrameTimer {
 public:
  enum Mark : std::size_t { kBegin, kProjected, kSorted, kDrawn, kMarks };

  FrameTimer();
  /// In this order in every picture; of one whose kBegin finds no room nothing is timed.
  void mark(Mark mark);
  /// Of the oldest picture that is done and was not taken.
  [[nodiscard]] std::optional<StepTimes> take();

 private:
  static constexpr std::size_t kPictures = 4;

  std::array<std::array<GlQuery, kMarks>, kPictures> queries_;
  std::size_t begun_ = 0, taken_ = 0;
  bool timing_ = false;
};

}  // namespace splatbus::viewer::gl
