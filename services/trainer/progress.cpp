#include "trainer/trainer.h"

namespace splatbus::trainer {

namespace {
constexpr double kWindow_s = 1.0;
constexpr double kLossMemory = 0.95;
}  // namespace

void Progress::add(double seconds, std::size_t views, double loss) {
  recent_.push_back({.seconds = seconds, .views = views});
  recent_s_ += seconds;
  recent_views_ += views;
  while (recent_.size() > 1 && recent_s_ - recent_.front().seconds >= kWindow_s) {
    recent_s_ -= recent_.front().seconds;
    recent_views_ -= recent_.front().views;
    recent_.pop_front();
  }
  loss_ = any_ ? kLossMemory * loss_ + (1 - kLossMemory) * loss : loss;
  any_ = true;
}

double Progress::steps_per_s() const {
  return recent_s_ > 0 ? static_cast<double>(recent_.size()) / recent_s_ : 0;
}

double Progress::views_per_s() const {
  return recent_s_ > 0 ? static_cast<double>(recent_views_) / recent_s_ : 0;
}

}  // namespace splatbus::trainer
