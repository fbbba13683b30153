#include "raster/loss_kernel.h"

#include <algorithm>
#include <array>

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

constexpr int kSsimRadius = 5, kTaps = 2 * kSsimRadius + 1;
/// Gaussian of sigma 1.5, normalised.
constexpr float kWindow[kTaps] = {0.00102838008447911F, 0.00759875813523919F, 0.03600077212843083F,
                                  0.10936068950970002F, 0.21300553771125370F, 0.26601172486179436F,
                                  0.21300553771125370F, 0.10936068950970002F, 0.03600077212843083F,
                                  0.00759875813523919F, 0.00102838008447911F};

/// The last rows of the picture, of a row's five blurred products (x, y, xx, yy, xy) and of its three gradients
/// (dSSIM/d(mean x, mean xx, mean xy)), blurred along rows; a vector's products lie together. Zero outside the picture.
class RowRing {
 public:
  static constexpr std::size_t kRows = 16, kProducts = 5, kGradients = 3, kPad = 32;
  static_assert(kRows >= kTaps + kSsimRadius, "a gradient's row looks back on rows of 2 radii before");

  static constexpr std::size_t stride(std::uint32_t width) { return (std::size_t{width} + 15) / 16 * 16; }
  static constexpr std::size_t floats(std::uint32_t width) {
    return kRows * stride(width) * (2 + kProducts + kGradients) + kProducts * (stride(width) + 2 * kPad);
  }

  RowRing(std::uint32_t width, float* memory) : stride_(stride(width)), memory_(memory) {
    std::fill_n(padded(0) - kPad, kProducts * (stride_ + 2 * kPad), 0.0F);
  }
  /// In display space.
  [[nodiscard]] float* shown(std::int64_t row) const { return memory_ + slot(row) * stride_; }
  [[nodiscard]] float* target(std::int64_t row) const { return memory_ + (kRows + slot(row)) * stride_; }
  [[nodiscard]] float* products(std::int64_t row) const {
    return memory_ + (2 * kRows + slot(row) * kProducts) * stride_;
  }
  [[nodiscard]] float* gradients(std::int64_t row) const {
    return memory_ + ((2 + kProducts) * kRows + slot(row) * kGradients) * stride_;
  }
  /// A row being worked on, with zeros on both sides for windows to overhang.
  [[nodiscard]] float* padded(std::size_t k) const {
    return memory_ + (2 + kProducts + kGradients) * kRows * stride_ + k * (stride_ + 2 * kPad) + kPad;
  }
  [[nodiscard]] std::size_t width() const { return stride_; }

 private:
  static std::size_t slot(std::int64_t row) { return static_cast<std::uint64_t>(row) % kRows; }
  std::size_t stride_;
  float* memory_;
};

HWY_INLINE V BlurRow(const float* centre) {
  const F f;
  V sum = hn::Mul(Splat1(kWindow[0]), hn::LoadU(f, centre - kSsimRadius));
  for (int t = 1; t < kTaps; ++t) sum = hn::MulAdd(Splat1(kWindow[t]), hn::LoadU(f, centre - kSsimRadius + t), sum);
  return sum;
}

/// A vector of each of kPlanes, blurred down columns of rows that interleave them.
template <std::size_t kPlanes>
struct ColumnBlur {
  std::array<const float*, kTaps> rows;

  HWY_INLINE void At(std::size_t x, V* sums) const {
    const F f;
    for (std::size_t k = 0; k < kPlanes; ++k) sums[k] = hn::Zero(f);
    for (int t = 0; t < kTaps; ++t) {
      const V weight = Splat1(kWindow[t]);
      const float* row = rows[static_cast<std::size_t>(t)] + x * kPlanes;
      for (std::size_t k = 0; k < kPlanes; ++k)
        sums[k] = hn::MulAdd(weight, hn::Load(f, row + k * hn::Lanes(f)), sums[k]);
    }
  }
};

constexpr float kLinearEnd = 0.0031308F;

/// The sRGB curve of x in [0, 1].
HWY_INLINE V EncodeSrgb(V x) {
  const F f;
  const V safe = hn::Max(x, Splat1(kLinearEnd));
  const V power = Exp2(hn::Mul(hn::Log2(f, safe), Splat1(1 / 2.4F)));
  return hn::IfThenElse(hn::Le(x, Splat1(kLinearEnd)), hn::Mul(x, Splat1(12.92F)),
                        hn::MulAdd(power, Splat1(1.055F), Splat1(-0.055F)));
}

/// Targets below 0 stand for what is rendered.
void MarkMasked(const std::uint8_t* mask, std::uint32_t width, float* target) {
  for (std::uint32_t x = 0; x < width; ++x) {
    if (mask[x] != 0) target[x] = -1.0F;
  }
}

/// Reads a row of picture and target, and blurs its products along it.
void BlurProducts(const LossChannel& in, std::int64_t row, const RowRing& ring) {
  const F f;
  const std::size_t lanes = hn::Lanes(f);
  float* products = ring.products(row);
  if (row < 0 || row >= in.height) {
    std::fill_n(products, RowRing::kProducts * ring.width(), 0.0F);
    return;
  }
  const std::size_t offset = static_cast<std::size_t>(row) * in.width;
  float* y_row = ring.padded(1);
  for (std::uint32_t x = 0; x < in.width; ++x) {
    y_row[x] = static_cast<float>(in.target_rgba[4 * (offset + x) + in.channel]) * (1.0F / 255.0F);
  }
  if (in.mask != nullptr) MarkMasked(in.mask + offset, in.width, y_row);
  for (std::size_t x = 0; x < in.width; x += lanes) {
    const V raw = LoadFirst(f, in.rendered + offset + x, in.width - x);  // zero beyond the picture, as is what follows
    V shown = hn::Min(hn::Max(raw, hn::Zero(f)), Splat1(1.0F));
    if (in.encode_srgb) shown = EncodeSrgb(shown);
    V target = hn::Load(f, y_row + x);
    if (in.mask != nullptr) {
      target = hn::IfThenElse(hn::Lt(target, hn::Zero(f)), shown, target);
      hn::Store(target, f, y_row + x);
    }
    hn::Store(shown, f, ring.shown(row) + x);
    hn::Store(target, f, ring.target(row) + x);
    hn::Store(shown, f, ring.padded(0) + x);
    hn::Store(hn::Mul(shown, shown), f, ring.padded(2) + x);
    hn::Store(hn::Mul(target, target), f, ring.padded(3) + x);
    hn::Store(hn::Mul(shown, target), f, ring.padded(4) + x);
  }
  for (std::size_t x = 0; x < in.width; x += lanes) {
    for (std::size_t k = 0; k < RowRing::kProducts; ++k) {
      hn::Store(BlurRow(ring.padded(k) + x), f, products + x * RowRing::kProducts + k * lanes);
    }
  }
}

/// SSIM of a row, whose gradients it blurs along it; returns the sums over it.
LossSums Ssim(const LossChannel& in, std::int64_t row, const RowRing& ring) {
  const F f;
  const std::size_t lanes = hn::Lanes(f);
  float* gradients = ring.gradients(row);
  if (row < 0 || row >= in.height) {
    std::fill_n(gradients, RowRing::kGradients * ring.width(), 0.0F);
    return {};
  }
  ColumnBlur<RowRing::kProducts> blur;
  for (int t = 0; t < kTaps; ++t) blur.rows[static_cast<std::size_t>(t)] = ring.products(row - kSsimRadius + t);
  const float* shown = ring.shown(row);
  const float* target = ring.target(row);
  const V c1 = Splat1(0.01F * 0.01F), c2 = Splat1(0.03F * 0.03F), two = Splat1(2.0F), one = Splat1(1.0F);
  V ssim_sum = hn::Zero(f), l1_sum = hn::Zero(f);
  for (std::size_t x = 0; x < in.width; x += lanes) {
    V blurred[RowRing::kProducts];
    blur.At(x, blurred);
    const V mean_x = blurred[0], mean_y = blurred[1], xx = blurred[2], yy = blurred[3], xy = blurred[4];
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
    const M inside = hn::FirstN(f, in.width - x);
    hn::Store(hn::IfThenElseZero(inside, by_mean), f, ring.padded(0) + x);
    hn::Store(hn::IfThenElseZero(inside, by_xx), f, ring.padded(1) + x);
    hn::Store(hn::IfThenElseZero(inside, by_xy), f, ring.padded(2) + x);
    ssim_sum = hn::Add(ssim_sum, hn::IfThenElseZero(inside, ssim));
    l1_sum = hn::Add(l1_sum, hn::AbsDiff(hn::Load(f, shown + x), hn::Load(f, target + x)));
  }
  for (std::size_t x = 0; x < in.width; x += lanes) {
    for (std::size_t k = 0; k < RowRing::kGradients; ++k) {
      hn::Store(BlurRow(ring.padded(k) + x), f, gradients + x * RowRing::kGradients + k * lanes);
    }
  }
  return {double{hn::GetLane(hn::SumOfLanes(f, l1_sum))}, double{hn::GetLane(hn::SumOfLanes(f, ssim_sum))}};
}

void Gradient(const LossChannel& in, std::int64_t row, const RowRing& ring) {
  const F f;
  const V zero = hn::Zero(f), one = Splat1(1.0F), two = Splat1(2.0F);
  const std::size_t offset = static_cast<std::size_t>(row) * in.width;
  ColumnBlur<RowRing::kGradients> blur;
  for (int t = 0; t < kTaps; ++t) blur.rows[static_cast<std::size_t>(t)] = ring.gradients(row - kSsimRadius + t);
  const float* shown_row = ring.shown(row);
  const float* target_row = ring.target(row);
  for (std::size_t x = 0; x < in.width; x += hn::Lanes(f)) {
    const std::size_t n = in.width - x;
    V blurred[RowRing::kGradients];
    blur.At(x, blurred);
    const V shown = hn::Load(f, shown_row + x), target = hn::Load(f, target_row + x);
    V g = hn::MulAdd(target, blurred[2], blurred[0]);
    g = hn::MulAdd(hn::Mul(two, shown), blurred[1], g);
    g = hn::Mul(g, Splat1(-in.ssim_scale));
    const V sign = hn::IfThenElse(hn::Gt(shown, target), one, hn::IfThenElseZero(hn::Lt(shown, target), Splat1(-1.0F)));
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
  if (in.mask == nullptr) return;
  for (std::uint32_t x = 0; x < in.width; ++x) {
    if (in.mask[offset + x] != 0) in.gradient[offset + x] = 0.0F;
  }
}

std::size_t ScratchFloats(std::uint32_t width) {
  return RowRing::floats(width);
}

LossSums LossRows(const LossChannel& in, std::uint32_t begin, std::uint32_t end, float* scratch) {
  const RowRing ring(in.width, scratch);
  const auto first = static_cast<std::int64_t>(begin), last = static_cast<std::int64_t>(end);
  constexpr std::int64_t kRadius = kSsimRadius;
  LossSums sums;
  for (std::int64_t row = first - 2 * kRadius; row < last + 2 * kRadius; ++row) {
    BlurProducts(in, row, ring);
    const std::int64_t middle = row - kRadius, done = row - 2 * kRadius;
    if (middle >= first - kRadius && middle < last + kRadius) {
      const LossSums of_row = Ssim(in, middle, ring);
      if (middle >= first && middle < last) {
        sums.l1 += of_row.l1;
        sums.ssim += of_row.ssim;
      }
    }
    if (done >= first) Gradient(in, done, ring);
  }
  return sums;
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster {
namespace cpu {
HWY_EXPORT(LossRows);
HWY_EXPORT(ScratchFloats);
std::size_t dispatch_scratch_floats(std::uint32_t width) {
  return HWY_DYNAMIC_DISPATCH(ScratchFloats)(width);
}
LossSums dispatch_loss_rows(const LossChannel& channel, std::uint32_t begin, std::uint32_t end, float* scratch) {
  return HWY_DYNAMIC_DISPATCH(LossRows)(channel, begin, end, scratch);
}
}  // namespace cpu

std::size_t loss_scratch_floats(std::uint32_t width) {
  return cpu::dispatch_scratch_floats(width);
}
LossSums loss_rows(const LossChannel& channel, std::uint32_t begin, std::uint32_t end, float* scratch) {
  return cpu::dispatch_loss_rows(channel, begin, end, scratch);
}
}  // namespace splatbus::raster
#endif
