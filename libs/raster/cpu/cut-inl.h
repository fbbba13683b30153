// An ellipse cut with rows of blocks; included once a Highway target.
#if defined(SPLATBUS_RASTER_CUT_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_CUT_INL_H
#undef SPLATBUS_RASTER_CUT_INL_H
#else
#define SPLATBUS_RASTER_CUT_INL_H
#endif

#include <algorithm>

#include "raster/cpu/frame.h"
#include "raster/cpu/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// Four rows of blocks (two of tiles) at a time: most Gaussians reach no more.
using F4 = hn::CappedTag<float, 4>;
using I4 = hn::RebindToSigned<F4>;
constexpr int kRows = 4;

/// Columns of blocks [first, last] that an ellipse reaches in kRows rows of blocks; empty where first > last.
struct Spans {
  HWY_ALIGN std::int32_t first[kRows];
  HWY_ALIGN std::int32_t last[kRows];

  /// Bits of the two blocks at `block` and `block + 1`.
  [[nodiscard]] HWY_INLINE std::uint32_t Bits(int row, std::int32_t block) const {
    return static_cast<std::uint32_t>(first[row] <= block && block <= last[row]) |
           static_cast<std::uint32_t>(first[row] <= block + 1 && block + 1 <= last[row]) << 1U;
  }
};

/// Rows of pixel centres within an ellipse's box, and what cuts them; empty where first > last.
struct RowsToCut {
  float reach2, last_column;
  std::int32_t first = 0, last = -1;

  HWY_INLINE RowsToCut(const Splat& splat, const Camera& camera)
      : reach2(splat.log2_alpha + 7.9943534F + 1e-3F), last_column(static_cast<float>(camera.width) - 1) {
    const auto bottom = static_cast<float>(camera.height) - 1;
    // Truncation is floor as both ends are made positive.
    const float low_y = std::max(splat.y - splat.extent_y + 0.5F, 0.0F);
    const float high_y = std::min(splat.y + splat.extent_y - 0.5F, bottom);
    if (!(high_y >= 0) || low_y > bottom + 1) return;
    first = static_cast<std::int32_t>(low_y);
    last = static_cast<std::int32_t>(high_y);
  }
};

/// The ellipse u^2 + v^2 <= reach2 cut with the pixel centres of rows of blocks. Within a band of dy its right end lies
/// at the dy of its rightmost point, clamped to the band; the left end is that of the mirrored ellipse.
HWY_INLINE void CutRows(const Splat& splat, float reach2, float first_row, float last_row, float last_column,
                        std::int32_t first_block_row, Spans& out) {
  const F4 f;
  const I4 d;
  const auto set = [&](float value) { return hn::Set(f, value); };
  const auto zero = hn::Zero(f);
  const auto inverse_uxx = hn::Div(set(1.0F), set(splat.uxx));
  for (int row = 0; row < kRows; row += static_cast<int>(hn::Lanes(f))) {
    const auto top = hn::Mul(hn::Iota(f, static_cast<float>(first_block_row + row)), set(float{kBlockSide}));
    const auto low = hn::Max(top, set(first_row));
    const auto high = hn::Min(hn::Add(top, set(float{kBlockSide} - 1)), set(last_row));
    const auto empty = hn::Gt(low, high);
    const auto low_dy = hn::Add(low, set(0.5F - splat.y)), high_dy = hn::Add(high, set(0.5F - splat.y));
    const auto right_dy = hn::Min(hn::Max(set(splat.rightmost_dy), low_dy), high_dy);
    const auto left_dy = hn::Min(hn::Max(set(-splat.rightmost_dy), low_dy), high_dy);
    const auto half_width = [&](auto dy) {
      const auto v = hn::Mul(set(splat.uyy), dy);
      return hn::Sqrt(hn::Max(hn::NegMulAdd(v, v, set(reach2)), zero));
    };
    const auto uxy = set(splat.uxy);
    const auto right =
        hn::MulAdd(hn::NegMulAdd(uxy, right_dy, half_width(right_dy)), inverse_uxx, set(splat.x - 0.49F));
    const auto left = hn::NegMulAdd(hn::MulAdd(uxy, left_dy, half_width(left_dy)), inverse_uxx, set(splat.x - 0.51F));
    // Columns of the first and last pixel centre between, then their blocks.
    const auto first = hn::Ceil(hn::Min(hn::Max(left, zero), set(last_column + 1)));
    const auto last = hn::Floor(hn::Max(hn::Min(right, set(last_column)), set(-1.0F)));
    const auto none = hn::Or(empty, hn::Gt(first, last));
    const auto first_block = hn::ShiftRight<2>(hn::ConvertTo(d, first));
    const auto last_block = hn::ShiftRight<2>(hn::ConvertTo(d, last));
    const auto none_d = hn::RebindMask(d, none);
    hn::Store(hn::IfThenElse(none_d, hn::Set(d, 1 << 28), first_block), d, out.first + row);
    hn::Store(hn::IfThenElse(none_d, hn::Set(d, -1), last_block), d, out.last + row);
  }
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
