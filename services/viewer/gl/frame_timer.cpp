#include "viewer/gl/frame_timer.h"

namespace splatbus::viewer::gl {

FrameTimer::FrameTimer() {
  for (auto& picture : queries_) {
    for (GlQuery& query : picture) query = make_query(GL_TIMESTAMP);
  }
}

void FrameTimer::mark(Mark mark) {
  if (mark == kBegin) {
    timing_ = begun_ - taken_ < kPictures;
    if (timing_) ++begun_;
  }
  if (timing_) glQueryCounter(queries_[(begun_ - 1) % kPictures][mark].get(), GL_TIMESTAMP);
}

std::optional<StepTimes> FrameTimer::take() {
  if (taken_ == begun_) return std::nullopt;
  const auto& picture = queries_[taken_ % kPictures];
  GLint done = GL_FALSE;
  glGetQueryObjectiv(picture[kDrawn].get(), GL_QUERY_RESULT_AVAILABLE, &done);
  if (done == GL_FALSE) return std::nullopt;
  std::array<GLuint64, kMarks> at_ns{};
  for (std::size_t k = 0; k < kMarks; ++k) glGetQueryObjectui64v(picture[k].get(), GL_QUERY_RESULT, &at_ns[k]);
  ++taken_;
  const auto between_ms = [&](Mark from, Mark to) { return static_cast<double>(at_ns[to] - at_ns[from]) / 1e6; };
  return StepTimes{.project_ms = between_ms(kBegin, kProjected),
                   .sort_ms = between_ms(kProjected, kSorted),
                   .draw_ms = between_ms(kSorted, kDrawn)};
}

}  // namespace splatbus::viewer::gl
