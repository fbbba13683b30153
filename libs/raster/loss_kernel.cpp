#include "raster/loss_kernel.h"

#include <algorithm>
#include <vector>

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/loss_kernel.cpp"
#include "hwy/foreach_target.h"
#include "hwy/contrib/math/math-inl.h"
#include "raster/cpu/lanes-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

constexpr int kTaps = 2 * kSsimRadius + 1;
/// Gaussian of sigma 1.5, normalised.
constexpr float kWindow[kTaps] = {0.00102838008447911F, 0.00759875813523919F, 0.03600077212843083F,
                                  0.10936068950970002F, 0.21300553771125370F, 0.26601172486179436F,
                                  0.21300553771125370F, 0.10936068950970002F, 0.03600077212843083F,
                                  0.00759875813523919F, 0.00102838008447911F};

/// A row with zeros on both sides, so that windows and vectors may overhang.
class PaddedRow {
 public:
  explicit PaddedRow(std::uint32_t width) : values_(width + 2 * kPad, 0.0F) {}
  [[nodiscard]] float* data() { return values_.data() + kPad; }
  [[nodiscard]] const float* data() const { return values_.data() + kPad; }

 private:
  static constexpr std::size_t kPad = 32;
  std::vector<float> values_;
};

HWY_INLINE V BlurRow(const float* centre) {
  const F f;
  V sum = hn::Mul(Splat1(kWindow[0]), hn::LoadU(f, centre - kSsimRadius));
  for (int t = 1; t < kTaps; ++t) sum = hn::MulAdd(Splat1(kWindow[t]), hn::LoadU(f, centre - kSsimRadius + t), sum);
  return sum;
}

/// The same down a column of a plane; rows outside the picture are zero.
HWY_INLINE V BlurColumn(const float* plane, const LossBand& in, std::uint32_t y, std::uint32_t x) {
  const F f;
  const int first = std::max(-kSsimRadius, -static_cast<int>(y));
  const int last = std::min(kSsimRadius, static_cast<int>(in.height - 1 - y));
  V sum = hn::Zero(f);
  for (int t = first; t <= last; ++t) {
    const float* row = plane + static_cast<std::size_t>(static_cast<int>(y - in.first_row) + t) * in.width;
    sum = hn::MulAdd(Splat1(kWindow[t + kSsimRadius]), LoadFirst(f, row + x, in.width - x), sum);
  }
  return sum;
}

constexpr float kLinearEnd = 0.0031308F;

/// The sRGB curve of x in [0, 1].
HWY_INLINE V EncodeSrgb(V x) {
  const F f;
  const V safe = hn::Max(x, Splat1(kLinearEnd));
  const V power = Exp2(hn::Mul(hn::Log2(f, safe), Splat1(1 / 2.4F)));
  return hn::IfThenElse(hn::Le(x, Splat1(kLinearEnd)), hn::Mul(x, Splat1(12.92F)),
                        hn::MulAdd(power, Splat1(1.055F), Splat1(-0.055F)));
}

void LossBlurRows(const LossBand& in, std::uint32_t begin, std::uint32_t end) {
  const F f;
  const std::size_t lanes = hn::Lanes(f);
  std::array<PaddedRow, 5> rows{PaddedRow(in.width), PaddedRow(in.width), PaddedRow(in.width), PaddedRow(in.width),
                                PaddedRow(in.width)};
  float* x_row = rows[0].data();
  float* y_row = rows[1].data();
  for (std::uint32_t y = begin; y < end; ++y) {
    const std::size_t offset = std::size_t{y} * in.width, local = std::size_t{y - in.first_row} * in.width;
    for (std::uint32_t x = 0; x < in.width; ++x) {
      y_row[x] = static_cast<float>(in.target_rgba[4 * (offset + x) + in.channel]) * (1.0F / 255.0F);
    }
    for (std::size_t x = 0; x < in.width; x += lanes) {
      const std::size_t n = in.width - x;
      const V raw = LoadFirst(f, in.rendered + offset + x, n);
      V shown = hn::Min(hn::Max(raw, hn::Zero(f)), Splat1(1.0F));
      if (in.encode_srgb) shown = EncodeSrgb(shown);
      StoreFirst(f, shown, x_row + x, n);
      const V target = LoadFirst(f, y_row + x, n);
      StoreFirst(f, shown, in.shown + local + x, n);
      StoreFirst(f, target, in.target + local + x, n);
      StoreFirst(f, hn::Mul(shown, shown), rows[2].data() + x, n);
      StoreFirst(f, hn::Mul(target, target), rows[3].data() + x, n);
      StoreFirst(f, hn::Mul(shown, target), rows[4].data() + x, n);
    }
    for (std::size_t x = 0; x < in.width; x += lanes) {
      for (std::size_t k = 0; k < 5; ++k) {
        StoreFirst(f, BlurRow(rows[k].data() + x), in.row_blurred[k] + local + x, in.width - x);
      }
    }
  }
}

LossSums LossSsimRows(const LossBand& in, std::uint32_t begin, std::uint32_t end) {
  const F f;
  const std::size_t lanes = hn::Lanes(f);
  const V c1 = Splat1(0.01F * 0.01F), c2 = Splat1(0.03F * 0.03F), two = Splat1(2.0F), one = Splat1(1.0F);
  std::array<PaddedRow, 3> rows{PaddedRow(in.width), PaddedRow(in.width), PaddedRow(in.width)};
  LossSums sums;
  for (std::uint32_t y = begin; y < end; ++y) {
    const std::size_t local = std::size_t{y - in.first_row} * in.width;
    V ssim_sum = hn::Zero(f), l1_sum = hn::Zero(f);
    for (std::size_t x = 0; x < in.width; x += lanes) {
      const std::size_t n = in.width - x;
      const auto column = [&](std::size_t k) {
        return BlurColumn(in.row_blurred[k], in, y, static_cast<std::uint32_t>(x));
      };
      const V mean_x = column(0), mean_y = column(1);
      const V xx = column(2), yy = column(3), xy = column(4);
      const V mean_xy = hn::Mul(mean_x, mean_y), mean_x2 = hn::Mul(mean_x, mean_x), mean_y2 = hn::Mul(mean_y, mean_y);
      const V a = hn::MulAdd(two, mean_xy, c1), b = hn::MulAdd(two, hn::Sub(xy, mean_xy), c2);
      const V c = hn::Add(hn::Add(mean_x2, mean_y2), c1);
      const V d = hn::Add(hn::Add(hn::Sub(xx, mean_x2), hn::Sub(yy, mean_y2)), c2);
      const V inverse_c = hn::Div(one, c), inverse_d = hn::Div(one, d);
      const V inverse_cd = hn::Mul(inverse_c, inverse_d);
      const V a_cd = hn::Mul(a, inverse_cd), ssim = hn::Mul(a_cd, b);
      const V by_xx = hn::Neg(hn::Mul(ssim, inverse_d)), by_xy = hn::Mul(two, a_cd);
      // By mean_x directly and through the variance and covariance.
      V by_mean = hn::Mul(hn::Mul(two, mean_y), hn::Sub(hn::Mul(b, inverse_cd), a_cd));
      by_mean = hn::MulAdd(hn::Mul(hn::Mul(two, mean_x), ssim), hn::Sub(inverse_d, inverse_c), by_mean);
      StoreFirst(f, by_mean, rows[0].data() + x, n);
      StoreFirst(f, by_xx, rows[1].data() + x, n);
      StoreFirst(f, by_xy, rows[2].data() + x, n);
      const M inside = hn::FirstN(f, n);
      const V difference = hn::AbsDiff(LoadFirst(f, in.shown + local + x, n), LoadFirst(f, in.target + local + x, n));
      ssim_sum = hn::Add(ssim_sum, hn::IfThenElseZero(inside, ssim));
      l1_sum = hn::Add(l1_sum, hn::IfThenElseZero(inside, difference));
    }
    sums.ssim += hn::GetLane(hn::SumOfLanes(f, ssim_sum));
    sums.l1 += hn::GetLane(hn::SumOfLanes(f, l1_sum));
    for (std::size_t x = 0; x < in.width; x += lanes) {
      for (std::size_t k = 0; k < 3; ++k) {
        StoreFirst(f, BlurRow(rows[k].data() + x), in.row_gradients[k] + local + x, in.width - x);
      }
    }
  }
  return sums;
}

void LossGradientRows(const LossBand& in, std::uint32_t begin, std::uint32_t end) {
  const F f;
  const V zero = hn::Zero(f), one = Splat1(1.0F), two = Splat1(2.0F);
  for (std::uint32_t y = begin; y < end; ++y) {
    const std::size_t offset = std::size_t{y} * in.width, local = std::size_t{y - in.first_row} * in.width;
    for (std::size_t x = 0; x < in.width; x += hn::Lanes(f)) {
      const std::size_t n = in.width - x;
      const auto column = [&](std::size_t k) {
        return BlurColumn(in.row_gradients[k], in, y, static_cast<std::uint32_t>(x));
      };
      const V shown = LoadFirst(f, in.shown + local + x, n), target = LoadFirst(f, in.target + local + x, n);
      V g = hn::MulAdd(target, column(2), column(0));
      g = hn::MulAdd(hn::Mul(two, shown), column(1), g);
      g = hn::Mul(g, Splat1(-in.ssim_scale));
      const V sign =
          hn::IfThenElse(hn::Gt(shown, target), one, hn::IfThenElseZero(hn::Lt(shown, target), Splat1(-1.0F)));
      g = hn::MulAdd(sign, Splat1(in.l1_scale), g);

      const V raw = LoadFirst(f, in.rendered + offset + x, n);
      if (in.encode_srgb) {
        const V linear = hn::Min(hn::Max(raw, Splat1(kLinearEnd)), one);
        const V power_slope = hn::Div(hn::Add(shown, Splat1(0.055F)), hn::Mul(linear, Splat1(2.4F)));
        g = hn::Mul(g, hn::IfThenElse(hn::Le(raw, Splat1(kLinearEnd)), Splat1(12.92F), power_slope));
      }
      // Outside [0, 1] only what leads back inside: a step goes against the gradient.
      const M stuck = hn::Or(hn::And(hn::Lt(raw, zero), hn::Gt(g, zero)), hn::And(hn::Gt(raw, one), hn::Lt(g, zero)));
      StoreFirst(f, hn::IfThenZeroElse(stuck, g), in.gradient + offset + x, n);
    }
  }
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster {
namespace cpu {
HWY_EXPORT(LossBlurRows);
HWY_EXPORT(LossSsimRows);
HWY_EXPORT(LossGradientRows);
void dispatch_blur(const LossBand& band, std::uint32_t begin, std::uint32_t end) {
  HWY_DYNAMIC_DISPATCH(LossBlurRows)(band, begin, end);
}
LossSums dispatch_ssim(const LossBand& band, std::uint32_t begin, std::uint32_t end) {
  return HWY_DYNAMIC_DISPATCH(LossSsimRows)(band, begin, end);
}
void dispatch_gradient(const LossBand& band, std::uint32_t begin, std::uint32_t end) {
  HWY_DYNAMIC_DISPATCH(LossGradientRows)(band, begin, end);
}
}  // namespace cpu

void loss_blur_rows(const LossBand& band, std::uint32_t begin, std::uint32_t end) {
  cpu::dispatch_blur(band, begin, end);
}
LossSums loss_ssim_rows(const LossBand& band, std::uint32_t begin, std::uint32_t end) {
  return cpu::dispatch_ssim(band, begin, end);
}
void loss_gradient_rows(const LossBand& band, std::uint32_t begin, std::uint32_t end) {
  cpu::dispatch_gradient(band, begin, end);
}
}  // namespace splatbus::raster
#endif
