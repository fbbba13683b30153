#include <algorithm>
#include <bit>

#include "raster/cpu/kernels.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "raster/cpu/project.cpp"
#include "hwy/foreach_target.h"
#include "raster/cpu/reach-inl.h"
#include "raster/cpu/shading-inl.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// The same as records: quarter q of lane l at values[q][4 l].
struct SplatQuarters {
  HWY_ALIGN float values[4][4 * hn::MaxLanes(F())];

  explicit HWY_INLINE SplatQuarters(const SplatPlanes& planes) {
    for (int q = 0; q < 4; ++q) {
      hn::StoreInterleaved4(planes.Get(4 * q), planes.Get(4 * q + 1), planes.Get(4 * q + 2), planes.Get(4 * q + 3), F(),
                            values[q]);
    }
  }
  HWY_INLINE void CopyLane(std::uint32_t lane, Splat& to) const {
    auto* out = reinterpret_cast<float*>(&to);
    for (std::size_t q = 0; q < 4; ++q) std::copy_n(values[q] + std::size_t{4} * lane, 4, out + 4 * q);
  }
};

/// -0 marks a channel that was clamped, so that the backward pass knows.
HWY_INLINE V ClampColour(V raw) {
  const V zero = hn::Zero(F());
  return hn::IfThenElse(hn::Lt(raw, zero), Splat1(-0.0F), hn::Add(raw, zero));
}

HWY_INLINE M Bounded(V value) {
  return hn::Lt(hn::Abs(value), Splat1(1e15F));
}

/// Gaussians whose geometry is known and whose colour is on its way from memory.
struct Placed {
  std::size_t i, n, end;
  const ObjectFrame* object;
  M visible;
  SplatPlanes planes;
};
constexpr std::size_t kBatch = 16;

/// Which of `lanes` may be seen, with all but the colours of their Splats in `planes`. Fetches meanwhile.
HWY_INLINE M PlaceLanes(const Frame& frame, const ObjectFrame& object, const GaussianLanes& in, M lanes,
                        ChannelFetch& fetch, SplatPlanes& planes) {
  const F f;
  const Vec3 mean{in.Load(0), in.Load(1), in.Load(2)};
  const V z = CameraPoint(object, mean).z;
  M visible = hn::And(lanes, hn::And(hn::Gt(z, Splat1(frame.camera.near_m)), Bounded(z)));
  if (hn::AllFalse(f, visible)) return visible;

  fetch.Some(10);
  const Projection p = Project(frame, object, in);
  fetch.Some(10);
  visible = hn::And(visible, hn::Ge(p.alpha, Splat1(kAlphaMin)));
  visible = hn::And(visible, hn::And(hn::Gt(p.det_blurred, hn::Zero(f)), hn::Lt(p.det_blurred, Splat1(1e30F))));
  visible = hn::And(visible, hn::And(Bounded(p.x), Bounded(p.y)));
  visible = hn::And(visible, hn::And(Bounded(p.a), Bounded(p.c)));
  if (hn::AllFalse(f, visible)) return visible;

  // U with U^T U = covariance^-1, without cancellation: 1 / sqrt(c) and b are the Schur complement's.
  const V inverse_root_c = hn::Div(Splat1(1.0F), hn::Sqrt(p.c));
  const V uxx = hn::Sqrt(hn::Div(p.c, p.det_blurred));
  const V uxy = hn::Neg(hn::Mul(hn::Mul(p.b, inverse_root_c), hn::Div(Splat1(1.0F), hn::Sqrt(p.det_blurred))));
  const V log2_alpha = hn::Log2(f, p.alpha);
  // Half sides of the box where alpha >= 1/255, with room for rounding.
  const V reach2 = MulScalar(hn::Add(log2_alpha, Splat1(7.9943534F)),
                             1.3862944F);  // 2 ln(255 alpha)
  const V reach = hn::Sqrt(hn::Max(reach2, hn::Zero(f)));
  const V root_a = hn::Sqrt(p.a), root_c = hn::Sqrt(p.c);
  const V margin = Splat1(1e-2F), slack = Splat1(1.0001F);
  const V extent_x = hn::MulAdd(hn::Mul(reach, root_a), slack, margin);
  const V extent_y = hn::MulAdd(hn::Mul(reach, root_c), slack, margin);
  const V half = Splat1(0.5F);
  visible = hn::And(visible, hn::Ge(hn::Add(p.x, extent_x), half));
  visible = hn::And(visible, hn::Ge(hn::Add(p.y, extent_y), half));
  visible = hn::And(visible, hn::Le(hn::Sub(p.x, extent_x), Splat1(static_cast<float>(frame.camera.width) - 0.5F)));
  visible = hn::And(visible, hn::Le(hn::Sub(p.y, extent_y), Splat1(static_cast<float>(frame.camera.height) - 0.5F)));
  if (hn::AllFalse(f, visible)) return visible;

  planes.Set(0, p.x);
  planes.Set(1, p.y);
  planes.Set(2, log2_alpha);
  planes.Set(3, MulScalar(uxx, kWhiteScale));
  planes.Set(4, MulScalar(uxy, kWhiteScale));
  planes.Set(5, MulScalar(inverse_root_c, kWhiteScale));
  planes.Set(9, z);
  planes.Set(13, extent_x);
  planes.Set(14, extent_y);
  const V rightmost_dy = hn::Div(hn::Mul(reach, p.b), root_a);
  planes.Set(15, rightmost_dy);
  (frame.keep ? SetReach<true> : SetReach<false>)(frame, p, extent_x, extent_y, rightmost_dy, fetch, planes);
  return visible;
}

/// Writes those that may be seen; returns the end of their keys.
HWY_INLINE DepthKey* WriteLanes(Frame& frame, const Placed& placed, M visible, DepthKey* out) {
  const SplatPlanes& planes = placed.planes;
  const SplatQuarters quarters(planes);
  for (std::uint32_t bits = LaneBits(visible); bits != 0; bits &= bits - 1) {
    const auto lane = static_cast<std::uint32_t>(std::countr_zero(bits));
    const auto gaussian = static_cast<std::uint32_t>(placed.i + lane);
    quarters.CopyLane(lane, frame.splats[gaussian]);
    frame.reaches[gaussian] = {planes.tile[lane], {planes.blocks[0][lane], planes.blocks[1][lane]}};
    *out++ = {std::bit_cast<std::uint32_t>(planes.values[9][lane]), gaussian};
  }
  return out;
}

/// Shades what was placed, and writes it; returns the end of the keys.
HWY_INLINE DepthKey* FinishBatch(Frame& frame, Placed* batch, std::size_t count, DepthKey* out) {
  const GaussiansView& gaussians = frame.gaussians;
  const bool transfer = gaussians.layout.appearance == Appearance::Transfer;
  RadianceBatch<kBatch> radiance;
  if (!transfer) {
    radiance.Shade(count, gaussians.layout.sh_degree, [&](std::size_t e) {
      return ObjectLanes{batch[e].object, {gaussians, batch[e].i, batch[e].n, batch[e].end}};
    });
  }
  for (std::size_t e = 0; e < count; ++e) {
    Placed& placed = batch[e];
    const V zero = hn::Zero(F());
    Vec3 colour, albedo{zero, zero, zero};
    M visible = placed.visible;
    if (transfer) {
      constexpr int kAlbedo = ParameterLayout::kAlbedo;
      const GaussianLanes in{gaussians, placed.i, placed.n, placed.end};
      albedo = {in.Load(kAlbedo), in.Load(kAlbedo + 1), in.Load(kAlbedo + 2)};
      colour = ShadeTransfer(*placed.object, in, albedo);
      if (HasSources(frame, *placed.object)) AddSources(frame, *placed.object, in, albedo, colour);
      visible = hn::And(visible, hn::And(Bounded(albedo.x), hn::And(Bounded(albedo.y), Bounded(albedo.z))));
    } else {
      colour = radiance.Colour(e);
    }
    visible = hn::And(visible, hn::And(Bounded(colour.x), hn::And(Bounded(colour.y), Bounded(colour.z))));
    placed.planes.Set(6, ClampColour(colour.x));
    placed.planes.Set(7, ClampColour(colour.y));
    placed.planes.Set(8, ClampColour(colour.z));
    placed.planes.Set(10, albedo.x);
    placed.planes.Set(11, albedo.y);
    placed.planes.Set(12, albedo.z);
    out = WriteLanes(frame, placed, visible, out);
  }
  return out;
}

std::size_t ProjectRange(Frame& frame, const IndexRange& piece, DepthKey* keys) {
  const F f;
  const std::size_t step = hn::Lanes(f), begin = piece.first, end = begin + piece.count;
  const GaussiansView& gaussians = frame.gaussians;
  DepthKey* out = keys;
  // While one vector's geometry is worked out, the appearance of the one before comes from memory.
  Placed batch[kBatch];
  std::size_t placed_count = 0;
  ChannelFetch fetch;
  std::uint32_t cached_id = piece.frame_id, cached_frame = frame.objects.find(cached_id);
  if (gaussians.object_id == nullptr && cached_frame == ObjectTable::kHidden) return 0;
  for (std::size_t i = begin; i < std::min(end, begin + 2 * step); i += step) {
    PrefetchChannels(gaussians, i, end, 0, ParameterLayout::kAppearance);
  }
  for (std::size_t i = begin; i < end; i += step) {
    const GaussianLanes in{gaussians, i, std::min(step, end - i), end};
    if (i + 2 * step < end) PrefetchChannels(gaussians, i + 2 * step, end, 0, ParameterLayout::kAppearance);
    for (std::size_t k = 0; k < in.n && frame.keep; ++k) frame.pair_ranges[i + k].count = 0;
    M remaining = hn::FirstN(f, in.n);
    std::uint32_t remaining_bits = LaneBits(remaining);
    // Lanes of one object at a time; neighbours nearly always share theirs.
    while (remaining_bits != 0) {
      M lanes = remaining;
      if (gaussians.object_id != nullptr) {
        const std::uint32_t* const id_of = gaussians.object_id + in.offset;
        const std::uint32_t id = id_of[std::countr_zero(remaining_bits)];
        if (id != cached_id) {
          cached_id = id;
          cached_frame = frame.objects.find(id);
        }
        const auto ids = LoadFirst(U(), id_of, in.n);
        lanes = hn::And(remaining, hn::RebindMask(f, hn::Eq(ids, hn::Set(U(), id))));
      }
      const std::uint32_t lane_bits = LaneBits(lanes);
      remaining_bits &= ~lane_bits;
      remaining = hn::AndNot(lanes, remaining);
      if (cached_frame == ObjectTable::kHidden) continue;
      Placed& placed = batch[placed_count];
      placed.i = i;
      placed.n = in.n;
      placed.end = end;
      placed.object = &frame.objects[cached_frame];
      placed.visible = PlaceLanes(frame, *placed.object, in, lanes, fetch, placed.planes);
      if (hn::AllFalse(f, placed.visible)) continue;
      fetch.Rest();
      fetch = ChannelFetch(in, ParameterLayout::kAppearance, gaussians.layout.channels());
      if (++placed_count < kBatch) continue;
      out = FinishBatch(frame, batch, placed_count, out);
      placed_count = 0;
    }
  }
  out = FinishBatch(frame, batch, placed_count, out);
  return static_cast<std::size_t>(out - keys);
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::raster::cpu {
HWY_EXPORT(ProjectRange);
std::size_t project_range(Frame& frame, const IndexRange& piece, DepthKey* visible) {
  return HWY_DYNAMIC_DISPATCH(ProjectRange)(frame, piece, visible);
}
}  // namespace splatbus::raster::cpu
#endif
