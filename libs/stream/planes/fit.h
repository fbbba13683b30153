#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "stream/planes/predict.h"
#include "stream/planes/shifts.h"

namespace splatbus::stream::planes {

/// Chooses how planes are predicted and coded, by what some of their lanes tell. Keeps its memory from plane to plane.
class PlaneFitter {
 public:
  explicit PlaneFitter(std::size_t count);

  enum class Effort : std::uint8_t {
    OwnOnly,  ///< Offset
    Colours,  ///< Offset, Channel
    All,
  };
  /// What comes is of these lanes, which stay until the next begin().
  void begin(const Lanes& lanes, Effort effort);
  /// The next plane, readable as values_to_residuals() wants. `before` is empty where it may not be predicted from.
  [[nodiscard]] PlaneModel fit(const Before& before, const std::int32_t* plane);
  /// [count] of the last fit(), with its model; undefined where that is Constant.
  [[nodiscard]] const std::int32_t* residuals() const { return residuals_.data(); }

 private:
  /// Of the sampled residuals with one shift.
  struct Moments {
    int shift = 0;
    float count = 0, zeros = 0, magnitude = 0, square = 0;
  };
  /// How far the sampled lanes are from what a predictor without offset says of them, into difference_.
  void sample(Predictor predictor, const Before& before, const std::int32_t* plane);
  [[nodiscard]] std::int32_t mean_difference() const;
  /// What the offset grows by a class, in eighths, and the offset, of difference_.
  [[nodiscard]] PlaneModel regression() const;
  /// Moments of difference_ with that offset.
  void measure(const PlaneModel& model);
  [[nodiscard]] float cost(Shape shape, int slope, int spread) const;
  /// Chooses shape, slope and spread; gives the bits.
  float choose(PlaneModel& model) const;

  std::size_t count_;
  std::vector<std::pair<std::size_t, std::size_t>> sampled_;  ///< lanes, from and to
  std::vector<std::uint8_t> no_shift_, sample_shift_, sample_context_;
  std::vector<std::int32_t> difference_, residuals_;
  std::array<std::uint32_t, kMaxShift + 1> at_shift_{};
  std::array<Moments, kMaxShift + 1> moments_;
  std::size_t used_shifts_ = 0;
  Lanes lanes_{};
  Effort effort_{};
};

}  // namespace splatbus::stream::planes
