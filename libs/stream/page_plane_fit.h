#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "stream/page_planes.h"
#include "stream/quantized.h"

// What the encoder of PageCodec::Planes decides.
namespace splatbus::stream::planes {

/// The highest class of each column that all its values admit, numbered from 0; all 0 where that would say little.
[[nodiscard]] std::vector<std::uint8_t> classes_of(const QuantizedGaussians& page, const StreamLayout& layout);

/// [count] of the attribute's values.
[[nodiscard]] std::vector<std::uint8_t> shifts_of(const QuantizedGaussians& page, const StreamLayout& layout,
                                                  Attribute attribute, const std::vector<std::uint8_t>& klass);

/// What the lanes of an attribute are told apart by, and how coarse each is.
struct Lanes {
  const std::uint8_t* context;  ///< [count]
  std::array<std::uint8_t, kClasses> shift{};
};

/// Chooses how a plane is predicted and coded. Keeps its memory from plane to plane.
class PlaneFitter {
 public:
  explicit PlaneFitter(std::size_t count) : residuals_(count) {}

  enum class Effort : std::uint8_t {
    OwnOnly,  ///< Offset
    Colours,  ///< Offset, Channel
    All,
  };
  [[nodiscard]] PlaneModel fit(const Lanes& lanes, std::span<const std::vector<std::int32_t>> before,
                               const std::vector<std::int32_t>& plane, Effort effort);
  /// [count] of the last fit(), with its model.
  [[nodiscard]] const std::int32_t* residuals() const { return residuals_.data(); }

 private:
  /// Of the residuals with one shift.
  struct Moments {
    std::int64_t count = 0, zeros = 0, magnitude = 0;
    double square = 0;
  };
  using MomentsOfShift = std::array<Moments, kMaxShift + 1>;

  static constexpr std::size_t kSample = 256;

  /// take(lane, shift, residual) for every `stride`-th lane.
  template <class Take>
  static void predict(const PlaneModel& model, const Lanes& lanes, std::span<const std::vector<std::int32_t>> before,
                      const std::vector<std::int32_t>& plane, std::size_t stride, Take take);
  /// Chooses shape, slope and spread; gives the bits.
  static double choose(PlaneModel& model, const MomentsOfShift& moments);

  std::vector<std::int32_t> residuals_;
};

}  // namespace splatbus::stream::planes
