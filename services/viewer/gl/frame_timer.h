#pragma once

#include <array>
#include <cstddef>
#include <optional>

#include "gl/objects.h"
#include "viewer/gl/draw_choice.h"

namespace splatbus::viewer::gl {

/// What the steps of a picture cost the device.
struct StepTimes {
  double project_ms = 0, sort_ms = 0;
  double pairs_ms = 0, tile_sort_ms = 0;  ///< by tiles alone
  double draw_ms = 0;                     ///< of quads, or the tiles' blending
  double resolve_ms = 0;                  ///< background and sRGB curve
  double all_ms = 0;
  Way way = Way::Quads;  ///< that was asked for
  unsigned trial = 0;    ///< as begin() had it
};

/// Times of pictures, without waiting for any: those that are on their way are kept apart. Of the context that was
/// current when it was made.
class FrameTimer {
 public:
  enum Mark : std::size_t { kBegin, kProjected, kSorted, kPaired, kTilesSorted, kDrawn, kResolved, kMarks };

  FrameTimer();
  /// Of a picture for which there is no room nothing is timed.
  void begin(Way way, unsigned trial);
  /// In this order; kPaired and kTilesSorted by tiles alone. Nothing is timed but between begin() and end().
  void mark(Mark mark);
  void end();
  /// Of the oldest picture that is done and was not taken.
  [[nodiscard]] std::optional<StepTimes> take();

 private:
  static constexpr std::size_t kPictures = 4;

  struct Timed {
    std::array<GlQuery, kMarks> queries;
    Way way = Way::Quads;
    unsigned trial = 0;
  };

  std::array<Timed, kPictures> pictures_;
  std::size_t begun_ = 0, taken_ = 0;
  bool timing_ = false;
};

}  // namespace splatbus::viewer::gl
