#include <cmath>

#include "trainer/trainer.h"

namespace splatbus::trainer {

namespace {
constexpr double kWindow_s = 1.0;
constexpr double kLossMemory = 0.95;
}  // namespace

void Progress::add(const StepReport& report) {
  if (report.steps == 0) return;
  recent_.push_back(report);
  recent_s_ += report.seconds;
  recent_steps_ += report.steps;
  recent_views_ += report.views;
  while (recent_.size() > 1 && recent_s_ - recent_.front().seconds >= kWindow_s) {
    recent_s_ -= recent_.front().seconds;
    recent_steps_ -= recent_.front().steps;
    recent_views_ -= recent_.front().views;
    recent_.pop_front();
  }
  const double memory = any_ ? std::pow(kLossMemory, static_cast<double>(report.steps)) : 0.0;
  loss_ = memory * loss_ + (1 - memory) * report.loss;
  any_ = true;
}

double Progress::steps_per_s() const {
  return recent_s_ > 0 ? static_cast<double>(recent_steps_) / recent_s_ : 0;
}

double Progress::views_per_s() const {
  return recent_s_ > 0 ? static_cast<double>(recent_views_) / recent_s_ : 0;
}

}  // namespace splatbus::trainer
