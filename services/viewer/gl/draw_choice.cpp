#include "viewer/gl/draw_choice.h"

#include <algorithm>

namespace splatbus::viewer::gl {
namespace {

constexpr std::size_t kIdlePictures = 2;  // pictures until memory is there and clocks are up
constexpr std::size_t kTimed = 3;         // of each way
constexpr std::size_t kGrown = 4;

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

DrawChoice::DrawChoice(Draw draw) : draw_(draw), chosen_(draw == Draw::Tiles ? Way::Tiles : Way::Quads) {}

void DrawChoice::begin_trial() {
  trying_ = true;
  ++trial_;
  begun_ = {};
  for (auto& times : times_ms_) times.clear();
}

Way DrawChoice::next(std::size_t rows) {
  if (draw_ != Draw::Auto) return chosen_;
  if (rows > 0 && (rows >= kGrown * tried_rows_ || kGrown * rows <= tried_rows_)) {
    tried_rows_ = rows;
    begin_trial();
  }
  if (!trying_) return chosen_;
  const Way way = begun_[0] <= begun_[1] ? Way::Quads : Way::Tiles;
  ++begun_[static_cast<std::size_t>(way)];
  return way;
}

void DrawChoice::took(unsigned trial, Way way, double ms) {
  if (!trying_ || trial != trial_) return;
  times_ms_[static_cast<std::size_t>(way)].push_back(ms);
  if (std::ranges::any_of(times_ms_, [](const auto& times) { return times.size() < kIdlePictures + kTimed; })) return;
  for (std::size_t k = 0; k < kWays; ++k) {
    cost_ms_[k] = median({times_ms_[k].begin() + kIdlePictures, times_ms_[k].end()});
  }
  chosen_ = cost_ms_[1] < cost_ms_[0] ? Way::Tiles : Way::Quads;
  trying_ = false;
  decided_ = trial_;
}

void DrawChoice::try_again() {
  if (trying_) begin_trial();
}

}  // namespace splatbus::viewer::gl
