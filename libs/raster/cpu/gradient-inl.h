// The backward pass of projection and shading, 16 Gaussians at a time; included once a Highway target.
#if defined(SPLATBUS_RASTER_GRADIENT_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_GRADIENT_INL_H
#undef SPLATBUS_RASTER_GRADIENT_INL_H
#else
#define SPLATBUS_RASTER_GRADIENT_INL_H
#endif

#include "hwy/cache_control.h"
#include "raster/cpu/shading-inl.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// The fields of PairGradient, summed over a Gaussian's tiles.
struct PixelSums {
  V s, su, sv, suu, suv, svv;
  Vec3 colour;
  V depth;
  Vec3 albedo;
  V largest_weight;
};

/// Slots of neighbouring Gaussians lie apart, in depth order, and lead to entries in many tiles: both are fetched
/// ahead.
template <class Fetch>
HWY_INLINE void ForPairs(const Frame& frame, std::size_t begin, std::size_t piece_end, Fetch&& fetch) {
  const std::size_t end = std::min(begin + hn::Lanes(F()), piece_end);
  for (std::size_t i = begin; i < end; ++i) {
    const PairRange& range = frame.pair_ranges[i];
    if (range.count != 0) fetch(&frame.entry_of_slot[frame.piece_slot[range.piece] + range.first], range.count);
  }
}
HWY_INLINE void PrefetchSlots(const Frame& frame, std::size_t begin, std::size_t piece_end) {
  ForPairs(frame, begin, piece_end, [](const std::uint32_t* entries, std::uint32_t) { hwy::Prefetch(entries); });
}
HWY_INLINE void PrefetchPairGradients(const Frame& frame, std::size_t begin, std::size_t piece_end) {
  ForPairs(frame, begin, piece_end, [&](const std::uint32_t* entries, std::uint32_t count) {
    for (std::uint32_t k = 0; k < std::min(count, 8U); ++k) {
      if (frame.pair_written[entries[k]] != 0) hwy::Prefetch(&frame.pair_gradients[entries[k]]);
    }
  });
}
/// Before the first vector of a piece.
HWY_INLINE void PrefetchFirstPairs(const Frame& frame, std::size_t begin, std::size_t piece_end) {
  PrefetchSlots(frame, begin, piece_end);
  PrefetchSlots(frame, begin + hn::Lanes(F()), piece_end);
  PrefetchPairGradients(frame, begin, piece_end);
}
HWY_INLINE void PrefetchPairs(const Frame& frame, const GaussianLanes& in) {
  PrefetchSlots(frame, in.i + 2 * hn::Lanes(F()), in.end);
  PrefetchPairGradients(frame, in.i + hn::Lanes(F()), in.end);
}

/// Sums the pairs of the Gaussians of `in`, for lanes that blended into a pixel; returns those lanes.
HWY_INLINE M SumPairs(const Frame& frame, const GaussianLanes& in, PixelSums& out) {
  const F f;
  const hn::CappedTag<float, 16> record_tag;
  HWY_ALIGN float sums[hn::MaxLanes(F()) * 16];
  std::uint32_t bits = 0;
  PrefetchPairs(frame, in);
  for (std::size_t lane = 0; lane < hn::Lanes(f); ++lane) {
    float* sum = sums + lane * 16;
    for (std::size_t k = 0; k < 16; k += hn::Lanes(record_tag)) hn::Store(hn::Zero(record_tag), record_tag, sum + k);
    const std::size_t i = in.i + lane;
    if (lane >= in.n || frame.pair_ranges[i].count == 0) continue;
    const PairRange& range = frame.pair_ranges[i];
    const std::uint32_t first = frame.piece_slot[range.piece] + range.first, end = first + range.count;
    float largest = 0;
    for (std::uint32_t slot = first; slot < end; ++slot) {
      const std::uint32_t entry = frame.entry_of_slot[slot];
      if (frame.pair_written[entry] == 0) continue;
      bits |= 1U << lane;
      const auto* record = reinterpret_cast<const float*>(&frame.pair_gradients[entry]);
      largest = std::max(largest, frame.pair_gradients[entry].largest_weight);
      for (std::size_t k = 0; k < 16; k += hn::Lanes(record_tag)) {
        hn::Store(hn::Add(hn::Load(record_tag, sum + k), hn::Load(record_tag, record + k)), record_tag, sum + k);
      }
    }
    sum[13] = largest;
  }
  const std::uint8_t bytes[8] = {static_cast<std::uint8_t>(bits), static_cast<std::uint8_t>(bits >> 8U)};
  const M touched = hn::LoadMaskBits(f, bytes);
  if (bits == 0) return touched;
  const I d;
  const auto rows = hn::ShiftLeft<4>(hn::Iota(d, 0));
  const auto field = [&](int k) { return hn::GatherIndex(f, sums + k, rows); };
  out = {field(0),
         field(1),
         field(2),
         field(3),
         field(4),
         field(5),
         {field(6), field(7), field(8)},
         field(9),
         {field(10), field(11), field(12)},
         field(13)};
  return touched;
}

/// Gradients of the channels that shape a Gaussian.
struct ShapeGradient {
  Vec3 mean, log_scale;
  V qw, qx, qy, qz, opacity_logit;
  V x_ndc, y_ndc;  ///< of the projected mean, in NDC units
};

HWY_INLINE ShapeGradient ShapeBackward(const Frame& frame, const ObjectFrame& object, const Projection& p,
                                       const PixelSums& sums) {
  const F f;
  const V zero = hn::Zero(f), one = Splat1(1.0F), two = Splat1(2.0F);
  const Camera& camera = frame.camera;
  // The blending pass summed s times powers of (u, v) = k U d with k = kWhiteScale and U^T U = covariance^-1; 1/k^2 = 2
  // ln 2.
  constexpr float kUnwhite = 1.3862943611198906F;
  const V root_det = hn::Sqrt(p.det_blurred), root_c = hn::Sqrt(p.c);
  const V uxx = MulScalar(hn::Div(root_c, root_det), kWhiteScale);
  const V uxy = MulScalar(hn::Div(p.b, hn::Mul(root_c, root_det)), -kWhiteScale);
  const V uyy = hn::Div(Splat1(kWhiteScale), root_c);

  // alpha = o exp(-(u^2 + v^2) / (2 k^2)): dL/d(x, y) = U^T sum s (u, v) / k, with U here times k.
  const V gx = MulScalar(hn::Mul(uxx, sums.su), kUnwhite);
  const V gy = MulScalar(hn::MulAdd(uxy, sums.su, hn::Mul(uyy, sums.sv)), kUnwhite);

  // dL/dcovariance = 1/2 sum s (Q d)(Q d)^T, Q the inverse covariance; Q d = U^T (u, v).
  constexpr float kHalf = 0.5F * kUnwhite * kUnwhite;
  const V xx = hn::Mul(hn::Mul(uxx, uxx), sums.suu);
  const V xy = hn::Mul(uxx, hn::MulAdd(uxy, sums.suu, hn::Mul(uyy, sums.suv)));
  const V yy = hn::MulAdd(hn::Mul(uxy, uxy), sums.suu,
                          hn::MulAdd(hn::Mul(two, hn::Mul(uxy, uyy)), sums.suv, hn::Mul(hn::Mul(uyy, uyy), sums.svv)));
  V ga = MulScalar(xx, kHalf), gb = MulScalar(xy, 2 * kHalf), gc = MulScalar(yy, kHalf);

  // ln alpha holds half of ln(det sharp / det blurred), and det sharp = |m0 x m1|^2.
  Vec3 gm0{zero, zero, zero}, gm1{zero, zero, zero};
  if (frame.options.antialias) {
    const V by_det = hn::Div(sums.s, p.det_blurred), half = Splat1(0.5F);
    ga = hn::NegMulAdd(hn::Mul(half, by_det), p.c, ga);
    gc = hn::NegMulAdd(hn::Mul(half, by_det), p.a, gc);
    gb = hn::MulAdd(by_det, p.b, gb);
    const Vec3 g_minor = Scale(p.minor, hn::Div(sums.s, p.det_sharp));
    gm0 = Cross(p.m1, g_minor);
    gm1 = Cross(g_minor, p.m0);
  }
  const V ga2 = hn::Add(ga, ga), gc2 = hn::Add(gc, gc);
  gm0 = Add3(gm0, Add3(Scale(p.m0, ga2), Scale(p.m1, gb)));
  gm1 = Add3(gm1, Add3(Scale(p.m0, gb), Scale(p.m1, gc2)));

  ShapeGradient out;
  out.log_scale = {hn::MulAdd(gm0.x, p.m0.x, hn::Mul(gm1.x, p.m1.x)), hn::MulAdd(gm0.y, p.m0.y, hn::Mul(gm1.y, p.m1.y)),
                   hn::MulAdd(gm0.z, p.m0.z, hn::Mul(gm1.z, p.m1.z))};
  const Vec3 gn0{hn::Mul(gm0.x, p.scale.x), hn::Mul(gm0.y, p.scale.y), hn::Mul(gm0.z, p.scale.z)};
  const Vec3 gn1{hn::Mul(gm1.x, p.scale.x), hn::Mul(gm1.y, p.scale.y), hn::Mul(gm1.z, p.scale.z)};

  // N = T R.
  const Vec3 gr0 = Add3(Scale(gn0, p.t0.x), Scale(gn1, p.t1.x));
  const Vec3 gr1 = Add3(Scale(gn0, p.t0.y), Scale(gn1, p.t1.y));
  const Vec3 gr2 = Add3(Scale(gn0, p.t0.z), Scale(gn1, p.t1.z));
  const Vec3 gt0{Dot(gn0, p.r0), Dot(gn0, p.r1), Dot(gn0, p.r2)};
  const Vec3 gt1{Dot(gn1, p.r0), Dot(gn1, p.r1), Dot(gn1, p.r2)};

  // R of the normalised quaternion, then the normalisation.
  const V w = p.qw, x = p.qx, y = p.qy, z = p.qz;
  const V a01 = hn::Sub(gr1.x, gr0.y), a02 = hn::Sub(gr0.z, gr2.x), a12 = hn::Sub(gr2.y, gr1.z);
  const V s01 = hn::Add(gr0.y, gr1.x), s02 = hn::Add(gr0.z, gr2.x), s12 = hn::Add(gr1.z, gr2.y);
  const auto sum3 = [](V a, V b, V c, V d, V e, V g) { return hn::MulAdd(a, b, hn::MulAdd(c, d, hn::Mul(e, g))); };
  V gqw = sum3(x, a12, y, a02, z, a01);
  V gqx = hn::NegMulAdd(hn::Add(x, x), hn::Add(gr1.y, gr2.z), sum3(y, s01, z, s02, w, a12));
  V gqy = hn::NegMulAdd(hn::Add(y, y), hn::Add(gr0.x, gr2.z), sum3(x, s01, z, s12, w, a02));
  V gqz = hn::NegMulAdd(hn::Add(z, z), hn::Add(gr0.x, gr1.y), sum3(x, s02, y, s12, w, a01));
  const V along = hn::MulAdd(w, gqw, sum3(x, gqx, y, gqy, z, gqz));
  const V factor = hn::Add(p.inverse_norm, p.inverse_norm);
  out.qw = hn::Mul(hn::NegMulAdd(along, w, gqw), factor);
  out.qx = hn::Mul(hn::NegMulAdd(along, x, gqx), factor);
  out.qy = hn::Mul(hn::NegMulAdd(along, y, gqy), factor);
  out.qz = hn::Mul(hn::NegMulAdd(along, z, gqz), factor);

  // T = J W; J has fx/z, -fx tan_x/z, fy/z, -fy tan_y/z.
  const auto& m = object.camera_from_object;
  const auto with_row = [&](const Vec3& g, std::size_t row) {
    return MulAddScalar(g.x, m[3 * row], MulAddScalar(g.y, m[3 * row + 1], MulScalar(g.z, m[3 * row + 2])));
  };
  const V jx = with_row(gt0, 0), jxz = with_row(gt0, 2), jy = with_row(gt1, 1), jyz = with_row(gt1, 2);
  V g_inverse_z = MulScalar(hn::NegMulAdd(p.tan_x, jxz, jx), camera.fx);
  g_inverse_z = MulAddScalar(hn::NegMulAdd(p.tan_y, jyz, jy), camera.fy, g_inverse_z);
  // The projected mean and the unclamped tangents: tan = X / z.
  V g_tan_x = hn::IfThenElseZero(p.free_x, MulScalar(hn::Mul(p.inverse_z, jxz), -camera.fx));
  V g_tan_y = hn::IfThenElseZero(p.free_y, MulScalar(hn::Mul(p.inverse_z, jyz), -camera.fy));
  g_tan_x = MulAddScalar(gx, camera.fx, g_tan_x);
  g_tan_y = MulAddScalar(gy, camera.fy, g_tan_y);
  g_inverse_z = hn::MulAdd(g_tan_x, p.camera.x, hn::MulAdd(g_tan_y, p.camera.y, g_inverse_z));
  const Vec3 g_camera{hn::Mul(g_tan_x, p.inverse_z), hn::Mul(g_tan_y, p.inverse_z),
                      hn::NegMulAdd(hn::Mul(p.inverse_z, p.inverse_z), g_inverse_z, sums.depth)};
  const auto to_object = [&](std::size_t column) {
    return MulAddScalar(g_camera.x, m[column],
                        MulAddScalar(g_camera.y, m[3 + column], MulScalar(g_camera.z, m[6 + column])));
  };
  out.mean = {to_object(0), to_object(1), to_object(2)};
  out.opacity_logit = hn::Mul(sums.s, hn::Sub(one, p.opacity));
  out.x_ndc = MulScalar(gx, 0.5F * static_cast<float>(camera.width));
  out.y_ndc = MulScalar(gy, 0.5F * static_cast<float>(camera.height));
  return out;
}

/// The colour's gradient where its channel was not clamped.
HWY_INLINE Vec3 UnclampedColourGradient(const Frame& frame, const GaussianLanes& in, const Vec3& gradient) {
  const F f;
  HWY_ALIGN float colour[3][hn::MaxLanes(F())] = {};
  for (std::size_t lane = 0; lane < in.n; ++lane) {
    if (frame.pair_ranges[in.i + lane].count == 0) continue;
    const Splat& splat = frame.splats[in.i + lane];
    colour[0][lane] = splat.red;
    colour[1][lane] = splat.green;
    colour[2][lane] = splat.blue;
  }
  const auto free = [&](int c, V g) {
    return hn::IfThenZeroElse(hn::RebindMask(f, hn::Lt(hn::BitCast(I(), hn::Load(f, colour[c])), hn::Zero(I()))), g);
  };
  return {free(0, gradient.x), free(1, gradient.y), free(2, gradient.z)};
}

/// Calls emit(channel, gradient) for the SH channels; returns the gradient of the mean through the view direction.
template <class Emit>
HWY_INLINE Vec3 RadianceBackward(const ObjectFrame& object, const GaussianLanes& in, const Vec3& mean, const Vec3& g,
                                 Emit&& emit) {
  const int degree = in.gaussians.layout.sh_degree;
  const ViewDirection direction = DirectionFromCamera(object, mean);
  V along_basis[kMaxShCoefficients];
  ShBasis(direction.unit, degree, [&](int k, V basis) {
    const int channel = ParameterLayout::kAppearance + 3 * k;
    if (k > 0) {
      along_basis[k] =
          hn::MulAdd(g.x, in.Load(channel), hn::MulAdd(g.y, in.Load(channel + 1), hn::Mul(g.z, in.Load(channel + 2))));
    }
    emit(channel, hn::Mul(basis, g.x));
    emit(channel + 1, hn::Mul(basis, g.y));
    emit(channel + 2, hn::Mul(basis, g.z));
  });
  const Vec3 g_unit = ShBasisGradient(direction.unit, degree, along_basis);
  const V radial = Dot(g_unit, direction.unit);
  return {hn::Mul(hn::NegMulAdd(radial, direction.unit.x, g_unit.x), direction.inverse_length),
          hn::Mul(hn::NegMulAdd(radial, direction.unit.y, g_unit.y), direction.inverse_length),
          hn::Mul(hn::NegMulAdd(radial, direction.unit.z, g_unit.z), direction.inverse_length)};
}

/// The mean gets nothing through a light: geometry is not to move in order to explain brightness.
template <bool kSources, class Emit>
HWY_INLINE void TransferBackward(const Frame& frame, const ObjectFrame& object, const GaussianLanes& in, const Vec3& g,
                                 const Vec3& g_albedo, bool residual, Emit&& emit) {
  TransferLight light = LightTransfer(object, in);
  SourceLight sources;
  if constexpr (kSources) {
    SumSources(frame, object, in, residual, sources);
    light.diffuse = Add3(light.diffuse, sources.diffuse);
  }
  const auto incident = [&](int entry) {
    const V of_sun = ResidualLight(object, light.visibility, entry);
    if constexpr (kSources) return hn::Add(of_sun, sources.residual[entry]);
    return of_sun;
  };
  emit(ParameterLayout::kAlbedo, hn::MulAdd(g.x, light.diffuse.x, g_albedo.x));
  emit(ParameterLayout::kAlbedo + 1, hn::MulAdd(g.y, light.diffuse.y, g_albedo.y));
  emit(ParameterLayout::kAlbedo + 2, hn::MulAdd(g.z, light.diffuse.z, g_albedo.z));
  if (!residual) return;
  for (int k = 0; k < 9; ++k) {
    const int channel = ParameterLayout::kResidual + 3 * k;
    emit(channel, hn::Mul(g.x, incident(3 * k)));
    emit(channel + 1, hn::Mul(g.y, incident(3 * k + 1)));
    emit(channel + 2, hn::Mul(g.z, incident(3 * k + 2)));
  }
}

/// All of it for the lanes of one object; emit(channel, gradient) once a channel. Returns |dL/d(projected mean)| in
/// NDC.
template <class Emit>
HWY_INLINE V GaussianBackward(const Frame& frame, const ObjectFrame& object, const GaussianLanes& in,
                              const PixelSums& sums, int active_channels, Emit&& emit) {
  const Projection p = Project(frame, object, in);
  ShapeGradient shape = ShapeBackward(frame, object, p, sums);
  const Vec3 colour = UnclampedColourGradient(frame, in, sums.colour);
  if (in.gaussians.layout.appearance == Appearance::Transfer) {
    const bool residual = active_channels > ParameterLayout::kResidual;
    (HasSources(frame, object) ? TransferBackward<true, Emit>
                               : TransferBackward<false, Emit>)(frame, object, in, colour, sums.albedo, residual, emit);
  } else {
    shape.mean = Add3(shape.mean, RadianceBackward(object, in, p.mean, colour, emit));
  }
  emit(0, shape.mean.x);
  emit(1, shape.mean.y);
  emit(2, shape.mean.z);
  emit(3, shape.log_scale.x);
  emit(4, shape.log_scale.y);
  emit(5, shape.log_scale.z);
  emit(6, shape.qw);
  emit(7, shape.qx);
  emit(8, shape.qy);
  emit(9, shape.qz);
  emit(ParameterLayout::kOpacityLogit, shape.opacity_logit);
  return hn::Sqrt(hn::MulAdd(shape.x_ndc, shape.x_ndc, hn::Mul(shape.y_ndc, shape.y_ndc)));
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
