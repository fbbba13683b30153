#include <algorithm>
#include <bit>

#include "raster/cpu/kernels.h"
#include "raster/unmodelled.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/project_backward.cpp"
#include "hwy/foreach_target.h"
#include "raster/cpu/gradient-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// Lanes that are not frozen.
HWY_INLINE M ActiveLanes(const GaussianLanes& in) {
  const F f;
  if (in.gaussians.flags == nullptr) return hn::FirstN(f, in.n);
  const U u;
  const auto frozen = hn::And(LoadFirst(u, in.gaussians.flags + in.offset, in.n), hn::Set(u, std::uint32_t{kFrozen}));
  return hn::And(hn::FirstN(f, in.n), hn::RebindMask(f, hn::Eq(frozen, hn::Zero(u))));
}

HWY_INLINE void AddTo(float* to, V value, std::size_t n) {
  const F f;
  StoreFirst(f, hn::Add(LoadFirst(f, to, n), value), to, n);
}

/// Adds the gradients of a vector's Gaussians that blended into a pixel.
HWY_INLINE void AddGradients(const Frame& frame, const GaussianLanes& in, const PixelSums& sums, M touched,
                             std::uint32_t piece_object, const GradientTarget& out) {
  const F f;
  const GaussiansView& gaussians = frame.gaussians;
  const std::size_t i = in.i;
  M remaining = hn::And(touched, ActiveLanes(in));
  std::uint32_t bits = LaneBits(remaining);
  bool add = out.zeroed;
  while (bits != 0) {
    M lanes = remaining;
    std::uint32_t object = piece_object;
    if (gaussians.object_id != nullptr) {
      const std::uint32_t* const id_of = gaussians.object_id + in.offset;
      const std::uint32_t id = id_of[std::countr_zero(bits)];
      object = frame.objects.find(id);
      lanes = hn::And(remaining, hn::RebindMask(f, hn::Eq(LoadFirst(U(), id_of, in.n), hn::Set(U(), id))));
    }
    const auto emit = [&](int channel, V gradient) {
      if (channel >= out.active_channels) return;
      float* plane = out.values + static_cast<std::size_t>(channel) * out.stride + i - out.origin;
      const V before = add ? LoadFirst(f, plane, in.n) : hn::Zero(f);
      StoreFirst(f, hn::Add(before, hn::IfThenElseZero(lanes, gradient)), plane, in.n);
    };
    const V ndc = GaussianBackward(frame, frame.objects[object], in, sums, out.active_channels, emit);
    AddTo(out.mean2d_norm + i, hn::IfThenElseZero(lanes, ndc), in.n);
    add = true;
    bits &= ~LaneBits(lanes);
    remaining = hn::AndNot(lanes, remaining);
  }
}

/// Without those of the far field whose middle lies where no sky is (RenderGradient::surface_depth).
HWY_INLINE M WithoutHiddenSky(const Frame& frame, std::size_t first, M touched) {
  std::uint32_t bits = LaneBits(touched);
  for (std::uint32_t rest = bits; rest != 0; rest &= rest - 1) {
    const std::uint32_t lane = std::countr_zero(rest);
    const Splat& splat = frame.splats[first + lane];
    // Where it lies, or nearest to that in the picture.
    const float x = std::clamp(splat.x, 0.0F, static_cast<float>(frame.camera.width - 1));
    const float y = std::clamp(splat.y, 0.0F, static_cast<float>(frame.camera.height - 1));
    const std::size_t at = static_cast<std::size_t>(y) * frame.camera.width + static_cast<std::size_t>(x);
    if (shows_surface(frame.surface_depth[at])) bits &= ~(1U << lane);
  }
  const std::uint8_t bytes[8] = {static_cast<std::uint8_t>(bits), static_cast<std::uint8_t>(bits >> 8U)};
  return hn::LoadMaskBits(F(), bytes);
}

void ProjectRangeBackward(const Frame& frame, const IndexRange& piece, const GradientTarget& out) {
  const F f;
  const std::size_t begin = piece.first, end = begin + piece.count;
  const std::uint32_t object = frame.objects.find(piece.frame_id);
  if (frame.gaussians.object_id == nullptr && object == ObjectTable::kHidden) return;
  const GaussiansView& gaussians = frame.gaussians;
  // While the pairs of one vector are summed, the parameters of the one before come from memory.
  struct Waiting {
    std::size_t i;
    M touched;
    PixelSums sums;
  } waiting{end, {}, {}};
  const auto finish = [&] {
    if (waiting.i < end) {
      AddGradients(frame, {gaussians, waiting.i, std::min(hn::Lanes(f), end - waiting.i), end}, waiting.sums,
                   waiting.touched, object, out);
    }
    waiting.i = end;
  };
  PrefetchFirstPairs(frame, begin, end);
  for (std::size_t i = begin; i < end; i += hn::Lanes(f)) {
    const GaussianLanes in{gaussians, i, std::min(hn::Lanes(f), end - i), end};
    PixelSums sums;
    M touched = SumPairs(frame, in, sums);
    if (frame.surface_depth != nullptr && piece.frame_id == kFarFieldFrame) {
      touched = WithoutHiddenSky(frame, i, touched);
    }
    const std::uint32_t bits = LaneBits(touched);
    if (bits == 0) continue;
    PrefetchChannels(gaussians, i, end, 0, std::min(out.active_channels, gaussians.layout.channels()));
    for (std::uint32_t rest = bits; rest != 0; rest &= rest - 1) {
      out.touched[i + static_cast<std::size_t>(std::countr_zero(rest))] = 1;
    }
    float* contribution = out.contribution + i;
    const V largest = hn::IfThenElseZero(touched, sums.largest_weight);
    StoreFirst(f, hn::Max(LoadFirst(f, contribution, in.n), largest), contribution, in.n);
    finish();
    waiting = {i, touched, sums};
  }
  finish();
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(ProjectRangeBackward);
void project_range_backward(const Frame& frame, const IndexRange& piece, const GradientTarget& out) {
  HWY_DYNAMIC_DISPATCH(ProjectRangeBackward)(frame, piece, out);
}
}  // namespace splatbus::raster::cpu
#endif
