#include "viewer/gl/color_playout.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

namespace splatbus::viewer::gl {
namespace {

/// Time that goes on by more than this at once was not shown in between.
constexpr std::int64_t kGap_ns = 250'000'000;

}  // namespace

void ColorPlayout::restart(std::int64_t of_ns) {
  waiting_.clear();
  waiting_rows_ = 0;
  from_ns_ = to_ns_ = std::max<std::int64_t>(of_ns, 0);
  part_ = 1;
}

void ColorPlayout::wrote(std::span<const std::uint32_t> rows) {
  stamp(rows, ++sequence_);
}

void ColorPlayout::add(const ColorUpdate& colors, std::int64_t of_ns, std::int64_t scene_ns) {
  if (scene_ns < scene_ns_) {
    for (Waiting& other : waiting_) other.of_ns = 0;  // of another engine, by another clock
    to_ns_ = 0;
  }
  scene_ns_ = scene_ns;
  // Of a later one they would be on their way for ever.
  of_ns = std::min(of_ns, scene_ns);
  to_ns_ = std::min(to_ns_, scene_ns);
  if (colors.rows.empty()) return;
  waiting_rows_ += colors.rows.size();
  const auto after =
      std::find_if(waiting_.begin(), waiting_.end(), [&](const Waiting& other) { return other.of_ns > of_ns; });
  waiting_.insert(after, {.colors = colors, .of_ns = of_ns, .came_ns = shown_ns_, .sequence = ++sequence_});
}

bool ColorPlayout::is_due(const Waiting& next, std::int64_t shown_ns) const {
  return shown_ns == 0 || next.of_ns <= to_ns_ || shown_ns >= to_ns_ || waiting_.size() > kMostWaiting ||
         waiting_rows_ > most_rows_;
}

void ColorPlayout::advance(std::int64_t shown_ns, RowStore& rows) {
  const bool jumped = std::abs(shown_ns - shown_ns_) > kGap_ns;
  while (!waiting_.empty() && is_due(waiting_.front(), shown_ns)) {
    Waiting next = std::move(waiting_.front());
    waiting_.erase(waiting_.begin());
    waiting_rows_ -= next.colors.rows.size();
    if (next.of_ns > to_ns_) {
      rows.keep_colors();
      // Who comes too late for all of the way takes what is left of it.
      from_ns_ = std::max(to_ns_, jumped ? shown_ns : next.came_ns);
      to_ns_ = next.of_ns;
    }
    keep_newer(next);
    rows.recolor(next.colors);
    stamp(next.colors.rows, next.sequence);
  }
  shown_ns_ = shown_ns;
  const std::int64_t way_ns = to_ns_ - from_ns_;
  const bool between = shown_ns != 0 && way_ns > 0 && shown_ns < to_ns_;
  part_ = between ? static_cast<float>(static_cast<double>(std::max<std::int64_t>(shown_ns - from_ns_, 0)) /
                                       static_cast<double>(way_ns))
                  : 1;
}

void ColorPlayout::stamp(std::span<const std::uint32_t> rows, std::uint64_t sequence) {
  const bool any =
      std::any_of(waiting_.begin(), waiting_.end(), [&](const Waiting& other) { return other.sequence < sequence; });
  if (!any || rows.empty()) return;
  written_.resize(std::max<std::size_t>(written_.size(), std::size_t{*std::max_element(rows.begin(), rows.end())} + 1));
  for (const std::uint32_t row : rows) written_[row] = std::max(written_[row], sequence);
}

void ColorPlayout::keep_newer(Waiting& waiting) const {
  ColorUpdate& colors = waiting.colors;
  std::size_t left = 0;
  for (std::size_t k = 0; k < colors.rows.size(); ++k) {
    const std::uint32_t row = colors.rows[k];
    if (row < written_.size() && written_[row] > waiting.sequence) continue;
    colors.rows[left] = row;
    colors.colors[left++] = colors.colors[k];
  }
  colors.rows.resize(left);
  colors.colors.resize(left);
}

}  // namespace splatbus::viewer::gl
