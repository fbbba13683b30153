#include "raster/adam_kernel.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "gaussians/model.h"
#include "raster/learning_age.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/adam_kernel.cpp"
#include "hwy/foreach_target.h"
#include "hwy/cache_control.h"
#include "hwy/contrib/math/math-inl.h"
#include "raster/cpu/lanes-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// The largest of the views' pixels a metre, squared; 0 behind all of them.
HWY_INLINE V Detail(const AdamStep& step, std::size_t k, std::size_t n) {
  const F f;
  const V x = LoadFirst(f, step.parameters + k, n), y = LoadFirst(f, step.parameters + step.stride + k, n),
          z = LoadFirst(f, step.parameters + 2 * step.stride + k, n);
  V finest = hn::Zero(f);
  for (std::size_t v = 0; v < step.distance_count; ++v) {
    const ViewDistance& view = step.distances[v];
    V depth = hn::MulAdd(Splat1(view.x), x, Splat1(view.offset));
    depth = hn::MulAdd(Splat1(view.z), z, hn::MulAdd(Splat1(view.y), y, depth));
    const V detail = hn::Div(Splat1(view.focal_px), hn::Max(depth, Splat1(kNearestDepth_m)));
    finest = hn::Max(finest, hn::IfThenElseZero(hn::Gt(depth, hn::Zero(f)), hn::Mul(detail, detail)));
  }
  return finest;
}

/// Whether the gradients of colour of the last steps agree with one another.
HWY_INLINE M GradientsAgree(const AdamStep& step, V t, std::size_t k, std::size_t n) {
  const F f;
  constexpr int kFirst = ParameterLayout::kAppearance;
  V mean2 = hn::Zero(f), square = hn::Zero(f);
  for (std::size_t c = kFirst; c < kFirst + 3; ++c) {
    const V m = LoadFirst(f, step.first + c * step.moment_stride + k, n);
    mean2 = hn::MulAdd(m, m, mean2);
    square = hn::Add(square, LoadFirst(f, step.second + c * step.moment_stride + k, n));
  }
  const V bias1 = hn::Expm1(f, MulScalar(t, std::log(step.beta1)));
  const V bias2 = hn::Neg(hn::Expm1(f, MulScalar(t, std::log(step.beta2))));
  return hn::Gt(hn::Mul(mean2, bias2), hn::Mul(hn::Mul(Splat1(kAgreement), square), hn::Mul(bias1, bias1)));
}

/// LearningAge of those that move, `steps` of them so far, this one included.
void Age(const AdamStep& step, const float* steps, std::size_t count, float* ages) {
  const F f;
  const V zero = hn::Zero(f), one = Splat1(1.0F);
  for (std::size_t k = 0; k < count; k += hn::Lanes(f)) {
    const std::size_t n = count - k;
    const V t = hn::Load(f, steps + k);
    const M moving = hn::Gt(t, zero);
    const V near_before = LoadFirst(f, step.near_steps + k, n);
    V near_steps = near_before;
    if (step.loss_has_risen) {
      near_steps = hn::IfThenElse(GradientsAgree(step, t, k, n), MulScalar(near_steps, kRecovery), near_steps);
    }
    if (step.distance_count == 0) {
      near_steps = hn::Add(near_steps, one);
    } else {
      const V detail_before = LoadFirst(f, step.detail + k, n), detail = Detail(step, k, n);
      const V finest = hn::Max(detail, detail_before);
      const M known = hn::Gt(finest, zero);
      const V share = hn::Div(hn::MulAdd(near_steps, detail_before, detail), hn::IfThenElse(known, finest, one));
      near_steps = hn::IfThenElse(known, share, hn::Add(near_steps, one));
      StoreFirst(f, hn::IfThenElse(moving, finest, detail_before), step.detail + k, n);
    }
    StoreFirst(f, hn::IfThenElse(moving, near_steps, near_before), step.near_steps + k, n);
    hn::Store(hn::Min(t, MulScalar(near_steps, kDetailSlack)), f, ages + k);
  }
}

void AdamRange(const AdamStep& step, std::size_t count) {
  const F f;
  const std::size_t lanes = hn::Lanes(f);
  // Bias corrections of every column, the first times its rate; one of 0 marks a column that rests.
  alignas(64) std::array<float, kAdamPiece> first_correction;
  alignas(64) std::array<float, kAdamPiece> second_correction;
  alignas(64) std::array<float, kAdamPiece> steps;
  alignas(64) std::array<float, kAdamPiece> ages;
  std::array<std::uint8_t, kAdamPiece> busy;  // a vector of columns
  steps.fill(0);
  bool any = false;
  for (std::size_t k = 0; k < count; ++k) {
    if (step.touched[k] == 0 || (step.flags != nullptr && (step.flags[k] & kFrozen) != 0)) continue;
    steps[k] = static_cast<float>(++step.steps[k]);
    any = true;
  }
  if (!any) return;
  if (step.lr_half_life_steps > 0) Age(step, steps.data(), count, ages.data());
  const V half = Splat1(step.lr_half_life_steps);
  const float log_beta1 = std::log(step.beta1), log_beta2 = std::log(step.beta2);
  for (std::size_t k = 0; k < count; k += lanes) {
    const V t = hn::Load(f, steps.data() + k);
    const M moving = hn::Gt(t, hn::Zero(f));
    busy[k / lanes] = hn::AllFalse(f, moving) ? 0 : 1;
    const V bias1 = hn::Neg(hn::Expm1(f, MulScalar(t, log_beta1))),
            bias2 = hn::Neg(hn::Expm1(f, MulScalar(t, log_beta2)));
    const V rate = step.lr_half_life_steps > 0
                       ? hn::Max(Splat1(step.lr_min_factor), hn::Div(half, hn::Add(half, hn::Load(f, ages.data() + k))))
                       : Splat1(1.0F);
    hn::Store(hn::IfThenElseZero(moving, hn::Div(rate, bias1)), f, first_correction.data() + k);
    hn::Store(hn::IfThenElse(moving, hn::Div(Splat1(1.0F), bias2), Splat1(1.0F)), f, second_correction.data() + k);
  }

  const V beta1 = Splat1(step.beta1), beta2 = Splat1(step.beta2), epsilon = Splat1(step.epsilon), one = Splat1(1.0F);
  const V rest1 = Splat1(1 - step.beta1), rest2 = Splat1(1 - step.beta2);
  for (int channel = 0; channel < step.channels; ++channel) {
    const auto plane = static_cast<std::size_t>(channel);
    float* parameters = step.parameters + plane * step.stride;
    const float* gradient = step.gradient + plane * step.gradient_stride;
    float* first = step.first + plane * step.moment_stride;
    float* second = step.second + plane * step.moment_stride;
    const V rate = Splat1(step.learning_rate[channel]);
    const bool unit = channel >= step.unit_begin && channel < step.unit_end;
    const V low = Splat1(unit ? 0.0F : -HUGE_VALF), high = Splat1(unit ? 1.0F : HUGE_VALF);
    // The next channel's columns come from memory meanwhile.
    const bool more = channel + 1 < step.channels;
    const std::size_t next = more ? step.stride : 0, next_moment = more ? step.moment_stride : 0;
    for (std::size_t k = 0; k < count; k += lanes) {
      if (busy[k / lanes] == 0) continue;
      const std::size_t n = count - k;
      const std::size_t last = std::min(n, lanes) - 1 + k;
      hwy::Prefetch(first + next_moment + last);
      hwy::Prefetch(second + next_moment + last);
      hwy::Prefetch(parameters + next + last);
      const V correction = hn::Load(f, first_correction.data() + k);
      const M moving = hn::Gt(correction, hn::Zero(f));
      const V g = LoadFirst(f, gradient + k, n);
      const V m_old = LoadFirst(f, first + k, n), v_old = LoadFirst(f, second + k, n);
      const V p_old = LoadFirst(f, parameters + k, n);
      const V m = hn::MulAdd(beta1, m_old, hn::Mul(rest1, g));
      const V v = hn::MulAdd(beta2, v_old, hn::Mul(rest2, hn::Mul(g, g)));
      // 1 / (sqrt(v) + epsilon) = r / (1 + epsilon r), r = 1 / sqrt(v) by one Newton step: no root, no division.
      const V s = hn::Max(hn::Mul(v, hn::Load(f, second_correction.data() + k)), Splat1(1e-36F));
      V r = hn::ApproximateReciprocalSqrt(s);
      r = hn::Mul(r, hn::NegMulAdd(hn::Mul(MulScalar(s, 0.5F), r), r, Splat1(1.5F)));
      const V inverse = hn::Mul(r, Reciprocal(hn::MulAdd(epsilon, r, one)));
      const V p = hn::Min(high, hn::Max(low, hn::NegMulAdd(hn::Mul(hn::Mul(rate, correction), m), inverse, p_old)));
      StoreFirst(f, hn::IfThenElse(moving, m, m_old), first + k, n);
      StoreFirst(f, hn::IfThenElse(moving, v, v_old), second + k, n);
      StoreFirst(f, hn::IfThenElse(moving, p, p_old), parameters + k, n);
    }
  }
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster {
namespace cpu {
HWY_EXPORT(AdamRange);
void dispatch_adam_range(const AdamStep& step, std::size_t count) {
  HWY_DYNAMIC_DISPATCH(AdamRange)(step, count);
}
}  // namespace cpu
void adam_range(const AdamStep& step, std::size_t count) {
  cpu::dispatch_adam_range(step, count);
}
}  // namespace splatbus::raster
#endif
