#include "viewer/gl/frame_timer.h"

namespace splatbus::viewer::gl {

FrameTimer::FrameTimer() {
  for (Timed& picture : pictures_) {
    for (GlQuery& query : picture.queries) query = make_query(GL_TIMESTAMP);
  }
}

void FrameTimer::begin(Way way, unsigned trial) {
  timing_ = begun_ - taken_ < kPictures;
  if (!timing_) return;
  Timed& picture = pictures_[begun_++ % kPictures];
  picture.way = way;
  picture.trial = trial;
  mark(kBegin);
}

void FrameTimer::mark(Mark mark) {
  if (timing_) glQueryCounter(pictures_[(begun_ - 1) % kPictures].queries[mark].get(), GL_TIMESTAMP);
}

void FrameTimer::end() {
  mark(kResolved);
  timing_ = false;
}

std::optional<StepTimes> FrameTimer::take() {
  if (taken_ == begun_) return std::nullopt;
  const Timed& picture = pictures_[taken_ % kPictures];
  GLint done = GL_FALSE;
  glGetQueryObjectiv(picture.queries[kResolved].get(), GL_QUERY_RESULT_AVAILABLE, &done);
  if (done == GL_FALSE) return std::nullopt;
  const bool tiles = picture.way == Way::Tiles;
  std::array<GLuint64, kMarks> at_ns{};
  for (std::size_t k = 0; k < kMarks; ++k) {
    if (!tiles && (k == kPaired || k == kTilesSorted)) {
      at_ns[k] = at_ns[kSorted];
    } else {
      glGetQueryObjectui64v(picture.queries[k].get(), GL_QUERY_RESULT, &at_ns[k]);
    }
  }
  ++taken_;
  const auto between_ms = [&](Mark from, Mark to) { return static_cast<double>(at_ns[to] - at_ns[from]) / 1e6; };
  return StepTimes{.project_ms = between_ms(kBegin, kProjected),
                   .sort_ms = between_ms(kProjected, kSorted),
                   .pairs_ms = between_ms(kSorted, kPaired),
                   .tile_sort_ms = between_ms(kPaired, kTilesSorted),
                   .draw_ms = between_ms(kTilesSorted, kDrawn),
                   .resolve_ms = between_ms(kDrawn, kResolved),
                   .all_ms = between_ms(kBegin, kResolved),
                   .way = picture.way,
                   .trial = picture.trial};
}

}  // namespace splatbus::viewer::gl
