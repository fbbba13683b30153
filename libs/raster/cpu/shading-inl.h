// Colour of Gaussians, 16 at a time; included once a Highway target.
#if defined(SPLATBUS_RASTER_SHADING_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_SHADING_INL_H
#undef SPLATBUS_RASTER_SHADING_INL_H
#else
#define SPLATBUS_RASTER_SHADING_INL_H
#endif

#include "gaussians/sh.h"
#include "raster/cpu/projection-inl.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// One band of the SH basis at unit directions; calls emit(k, Y_k).
template <int kBand, class Emit>
HWY_INLINE void ShBand(const Vec3& d, Emit&& emit) {
  static_assert(kBand <= 3);
  if constexpr (kBand == 0) {
    emit(0, Splat1(kShC0));
  } else if constexpr (kBand == 1) {
    emit(1, MulScalar(d.y, -kShC1));
    emit(2, MulScalar(d.z, kShC1));
    emit(3, MulScalar(d.x, -kShC1));
  } else {
    const V xx = hn::Mul(d.x, d.x), yy = hn::Mul(d.y, d.y), zz = hn::Mul(d.z, d.z);
    const V xy = hn::Mul(d.x, d.y), yz = hn::Mul(d.y, d.z), xz = hn::Mul(d.x, d.z);
    const V two = Splat1(2.0F), three = Splat1(3.0F), four = Splat1(4.0F);
    if constexpr (kBand == 2) {
      emit(4, MulScalar(xy, kShC2[0]));
      emit(5, MulScalar(yz, kShC2[1]));
      emit(6, MulScalar(hn::MulSub(two, zz, hn::Add(xx, yy)), kShC2[2]));
      emit(7, MulScalar(xz, kShC2[3]));
      emit(8, MulScalar(hn::Sub(xx, yy), kShC2[4]));
    } else {
      const V ring = hn::MulSub(four, zz, hn::Add(xx, yy));
      emit(9, MulScalar(hn::Mul(d.y, hn::MulSub(three, xx, yy)), kShC3[0]));
      emit(10, MulScalar(hn::Mul(xy, d.z), kShC3[1]));
      emit(11, MulScalar(hn::Mul(d.y, ring), kShC3[2]));
      emit(12, MulScalar(hn::Mul(d.z, hn::NegMulAdd(three, hn::Add(xx, yy), hn::Mul(two, zz))), kShC3[3]));
      emit(13, MulScalar(hn::Mul(d.x, ring), kShC3[4]));
      emit(14, MulScalar(hn::Mul(d.z, hn::Sub(xx, yy)), kShC3[5]));
      emit(15, MulScalar(hn::Mul(d.x, hn::NegMulAdd(three, yy, xx)), kShC3[6]));
    }
  }
}

/// The bands up to `degree`, one after the other.
template <class Emit>
HWY_INLINE void ShBasis(const Vec3& d, int degree, Emit&& emit) {
  ShBand<0>(d, emit);
  if (degree >= 1) ShBand<1>(d, emit);
  if (degree >= 2) ShBand<2>(d, emit);
  if (degree >= 3) ShBand<3>(d, emit);
}

/// sum_k w_k dY_k/d(x, y, z), the basis taken as polynomials of an unconstrained direction.
HWY_INLINE Vec3 ShBasisGradient(const Vec3& d, int degree, const V* w) {
  const V zero = hn::Zero(F());
  Vec3 g{zero, zero, zero};
  if (degree < 1) return g;
  g = {MulScalar(w[3], -kShC1), MulScalar(w[1], -kShC1), MulScalar(w[2], kShC1)};
  if (degree < 2) return g;
  const V w4 = MulScalar(w[4], kShC2[0]), w5 = MulScalar(w[5], kShC2[1]), w6 = MulScalar(w[6], 2 * kShC2[2]);
  const V w7 = MulScalar(w[7], kShC2[3]), w8 = MulScalar(w[8], 2 * kShC2[4]);
  g.x = hn::Add(g.x, hn::MulAdd(w4, d.y, hn::MulAdd(w7, d.z, hn::Mul(d.x, hn::Sub(w8, w6)))));
  g.y = hn::Add(g.y, hn::MulAdd(w4, d.x, hn::NegMulAdd(d.y, hn::Add(w8, w6), hn::Mul(w5, d.z))));
  g.z = hn::Add(g.z, hn::MulAdd(w5, d.y, hn::MulAdd(w7, d.x, hn::Mul(hn::Add(w6, w6), d.z))));
  if (degree < 3) return g;
  const V xx = hn::Mul(d.x, d.x), yy = hn::Mul(d.y, d.y), zz = hn::Mul(d.z, d.z);
  const V xy = hn::Mul(d.x, d.y), yz = hn::Mul(d.y, d.z), xz = hn::Mul(d.x, d.z);
  const V w9 = MulScalar(w[9], 3 * kShC3[0]), w10 = MulScalar(w[10], kShC3[1]), w11 = MulScalar(w[11], kShC3[2]);
  const V w12 = MulScalar(w[12], 3 * kShC3[3]), w13 = MulScalar(w[13], kShC3[4]), w14 = MulScalar(w[14], kShC3[5]);
  const V w15 = MulScalar(w[15], 3 * kShC3[6]);
  const V two = Splat1(2.0F), three = Splat1(3.0F), four = Splat1(4.0F), eight = Splat1(8.0F);
  const V difference = hn::Sub(xx, yy);
  // d/dx: w9 2xy + w10 yz - 2 w11 xy - 2 w12 xz + w13 (4zz - 3xx - yy) + 2 w14 xz + w15 (xx - yy)
  V x = hn::Mul(hn::Mul(two, xy), hn::Sub(w9, w11));
  x = hn::MulAdd(w10, yz, x);
  x = hn::MulAdd(hn::Mul(two, xz), hn::Sub(w14, w12), x);
  x = hn::MulAdd(w13, hn::NegMulAdd(three, xx, hn::MulSub(four, zz, yy)), x);
  g.x = hn::Add(g.x, hn::MulAdd(w15, difference, x));
  // d/dy: w9 (xx - yy) + w10 xz + w11 (4zz - xx - 3yy) - 2 w12 yz - 2 w13 xy - 2 w14 yz - 2 w15 xy
  V y = hn::Mul(w9, difference);
  y = hn::MulAdd(w10, xz, y);
  y = hn::MulAdd(w11, hn::NegMulAdd(three, yy, hn::MulSub(four, zz, xx)), y);
  y = hn::NegMulAdd(hn::Mul(two, yz), hn::Add(w12, w14), y);
  g.y = hn::Add(g.y, hn::NegMulAdd(hn::Mul(two, xy), hn::Add(w13, w15), y));
  // d/dz: w10 xy + 8 w11 yz + w12 (2zz - xx - yy) + 8 w13 xz + w14 (xx - yy)
  V z = hn::Mul(w10, xy);
  z = hn::MulAdd(eight, hn::MulAdd(w11, yz, hn::Mul(w13, xz)), z);
  z = hn::MulAdd(w12, hn::MulSub(two, zz, hn::Add(xx, yy)), z);
  g.z = hn::Add(g.z, hn::MulAdd(w14, difference, z));
  return g;
}

struct ViewDirection {
  Vec3 unit;
  V inverse_length;
};
HWY_INLINE ViewDirection DirectionFromCamera(const ObjectFrame& object, const Vec3& mean) {
  const Vec3 v{hn::Sub(mean.x, Splat1(object.camera_position[0])), hn::Sub(mean.y, Splat1(object.camera_position[1])),
               hn::Sub(mean.z, Splat1(object.camera_position[2]))};
  const V inverse_length = hn::Div(Splat1(1.0F), hn::Sqrt(Dot(v, v)));
  return {Scale(v, inverse_length), inverse_length};
}

/// A vector of Gaussians of one object.
struct ObjectLanes {
  const ObjectFrame* object;
  GaussianLanes in;
};

/// 0.5 + sum_k c_k Y_k of several vectors of Gaussians, a band of coefficients at a time: runs of a few planes, one
/// after the other, are what a core fetches ahead by itself, which it does not for all planes side by side.
template <std::size_t kMost>
class RadianceBatch {
 public:
  /// input_of(e) is the ObjectLanes of vector e.
  template <class InputOf>
  HWY_INLINE void Shade(std::size_t count, int degree, const InputOf& input_of) {
    ShadeBand<0>(count, input_of);
    if (degree >= 1) ShadeBand<1>(count, input_of);
    if (degree >= 2) ShadeBand<2>(count, input_of);
    if (degree >= 3) ShadeBand<3>(count, input_of);
  }

  [[nodiscard]] HWY_INLINE Vec3 Colour(std::size_t e) const { return LoadVec(colour_[e]); }

 private:
  static HWY_INLINE Vec3 LoadVec(const float (&from)[3][hn::MaxLanes(F())]) {
    return {hn::Load(F(), from[0]), hn::Load(F(), from[1]), hn::Load(F(), from[2])};
  }
  static HWY_INLINE void StoreVec(const Vec3& v, float (&to)[3][hn::MaxLanes(F())]) {
    hn::Store(v.x, F(), to[0]);
    hn::Store(v.y, F(), to[1]);
    hn::Store(v.z, F(), to[2]);
  }

  template <int kBand, class InputOf>
  HWY_INLINE void ShadeBand(std::size_t count, const InputOf& input_of) {
    for (std::size_t e = 0; e < count; ++e) {
      const ObjectLanes input = input_of(e);
      const GaussianLanes& in = input.in;
      Vec3 unit, sum{Splat1(0.5F), Splat1(0.5F), Splat1(0.5F)};
      if constexpr (kBand == 0) {
        unit = DirectionFromCamera(*input.object, {in.Load(0), in.Load(1), in.Load(2)}).unit;
        StoreVec(unit, direction_[e]);
      } else {
        unit = LoadVec(direction_[e]);
        sum = LoadVec(colour_[e]);
      }
      ShBand<kBand>(unit, [&](int k, V basis) {
        const int channel = ParameterLayout::kAppearance + 3 * k;
        sum.x = hn::MulAdd(basis, in.Load(channel), sum.x);
        sum.y = hn::MulAdd(basis, in.Load(channel + 1), sum.y);
        sum.z = hn::MulAdd(basis, in.Load(channel + 2), sum.z);
      });
      StoreVec(sum, colour_[e]);
    }
  }

  HWY_ALIGN float direction_[kMost][3][hn::MaxLanes(F())];
  HWY_ALIGN float colour_[kMost][3][hn::MaxLanes(F())];
};

/// What multiplies the albedo (diffuse) and what multiplies residual coefficient k, of the transfer model.
struct TransferLight {
  Vec3 diffuse;
  V visibility;
};

/// Of a light's row.
HWY_INLINE V LoadVisibility(const std::uint8_t* of_index, const GaussianLanes& in) {
  const hn::Rebind<std::uint8_t, F> bytes;
  HWY_ALIGN std::uint8_t lanes[hn::MaxLanes(F())] = {};
  for (std::size_t k = 0; k < in.n; ++k) lanes[k] = of_index[in.i + k];
  return MulScalar(hn::ConvertTo(F(), hn::PromoteTo(I(), hn::Load(bytes, lanes))), 1.0F / 255);
}

/// The sun's.
HWY_INLINE V LoadVisibility(const GaussianLanes& in) {
  if (const std::uint8_t* of_index = in.gaussians.visibility_u8) return LoadVisibility(of_index, in);
  const float* visibility = in.gaussians.visibility;
  return visibility == nullptr ? Splat1(1.0F) : LoadFirst(F(), visibility + in.offset, in.n);
}

/// Without normals, only what does not depend on them lights a Gaussian.
HWY_INLINE Vec3 LoadNormal(const GaussianLanes& in) {
  const float* normals = in.gaussians.normal;
  const std::size_t stride = in.gaussians.stride;
  if (normals == nullptr) return {hn::Zero(F()), hn::Zero(F()), hn::Zero(F())};
  return {LoadFirst(F(), normals + in.offset, in.n), LoadFirst(F(), normals + stride + in.offset, in.n),
          LoadFirst(F(), normals + 2 * stride + in.offset, in.n)};
}

HWY_INLINE TransferLight LightTransfer(const ObjectFrame& object, const GaussianLanes& in) {
  const Vec3 n = LoadNormal(in);
  TransferLight out;
  out.visibility = LoadVisibility(in);
  const auto& l = object.sun_direction;
  V cosine = MulAddScalar(n.x, l[0], MulAddScalar(n.y, l[1], MulScalar(n.z, l[2])));
  cosine = hn::Mul(hn::Max(cosine, hn::Zero(F())), out.visibility);
  out.diffuse = {MulScalar(cosine, object.sun_over_pi[0]), MulScalar(cosine, object.sun_over_pi[1]),
                 MulScalar(cosine, object.sun_over_pi[2])};
  ShBasis(n, 2, [&](int k, V basis) {
    const auto entry = 3 * static_cast<std::size_t>(k);
    out.diffuse.x = MulAddScalar(basis, object.ambient_lobe[entry], out.diffuse.x);
    out.diffuse.y = MulAddScalar(basis, object.ambient_lobe[entry + 1], out.diffuse.y);
    out.diffuse.z = MulAddScalar(basis, object.ambient_lobe[entry + 2], out.diffuse.z);
  });
  return out;
}

HWY_INLINE V ResidualLight(const ObjectFrame& object, V visibility, int entry) {
  return MulAddScalar(visibility, object.sun_sh[entry], Splat1(object.ambient[entry]));
}

/// The transfer model's colour before the max with 0.
HWY_INLINE Vec3 ShadeTransfer(const ObjectFrame& object, const GaussianLanes& in, const Vec3& albedo) {
  const TransferLight light = LightTransfer(object, in);
  Vec3 colour{hn::Mul(albedo.x, light.diffuse.x), hn::Mul(albedo.y, light.diffuse.y),
              hn::Mul(albedo.z, light.diffuse.z)};
  for (int k = 0; k < 9; ++k) {
    const int channel = ParameterLayout::kResidual + 3 * k;
    colour.x = hn::MulAdd(in.Load(channel), ResidualLight(object, light.visibility, 3 * k), colour.x);
    colour.y = hn::MulAdd(in.Load(channel + 1), ResidualLight(object, light.visibility, 3 * k + 1), colour.y);
    colour.z = hn::MulAdd(in.Load(channel + 2), ResidualLight(object, light.visibility, 3 * k + 2), colour.z);
  }
  return colour;
}

/// What the sources besides the sun add to what multiplies the albedo, and to what multiplies each residual channel.
struct SourceLight {
  Vec3 diffuse;
  V residual[27];  ///< 3 k + c
};

HWY_INLINE bool HasSources(const Frame& frame, const ObjectFrame& object) {
  return !frame.sources.empty() && !object.emissive;
}

/// Light is summed over the sources before it meets a Gaussian's channels, so that those are read once. Not inlined: a
/// scene without sources is not to pay for it.
inline HWY_NOINLINE void SumSources(const Frame& frame, const ObjectFrame& object, const GaussianLanes& in,
                                    bool residual, SourceLight& out) {
  const F f;
  const V zero = hn::Zero(f), one = Splat1(1.0F);
  out.diffuse = {zero, zero, zero};
  for (V& sum : out.residual) sum = zero;
  const Vec3 n = LoadNormal(in);
  const Vec3 point = CameraPoint(object, {in.Load(0), in.Load(1), in.Load(2)});
  const auto& w = object.camera_from_object;
  const V min_distance = Splat1(kMinSourceDistance_m * object.scale);
  const float inverse_scale = 1 / object.scale;
  for (const ShadingSource& source : frame.sources) {
    Vec3 to_light{Splat1(source.direction[0]), Splat1(source.direction[1]), Splat1(source.direction[2])};
    V weight = one;
    if (!source.directional) {
      const Vec3 axis = to_light;
      const Vec3 way{hn::Sub(Splat1(source.position[0]), point.x), hn::Sub(Splat1(source.position[1]), point.y),
                     hn::Sub(Splat1(source.position[2]), point.z)};
      const V distance = hn::Max(hn::Sqrt(Dot(way, way)), min_distance);
      const V share = MulScalar(distance, source.inverse_range), share2 = hn::Mul(share, share);
      const V window = hn::Max(hn::NegMulAdd(share2, share2, one), zero);
      const V inverse_distance = hn::Div(one, distance);
      to_light = Scale(way, inverse_distance);
      const V from_edge = hn::Neg(hn::Add(Dot(to_light, axis), Splat1(source.cos_outer)));
      const V cone = hn::Min(hn::Max(MulScalar(from_edge, source.inverse_cone), zero), one);
      const V root = hn::Mul(hn::Mul(window, inverse_distance), cone);
      weight = hn::Mul(root, root);
      if (hn::AllFalse(f, hn::Gt(weight, zero))) continue;
    }
    if (source.visibility != nullptr) {
      weight = hn::Mul(weight, LoadVisibility(source.visibility, in));
      if (hn::AllFalse(f, hn::Gt(weight, zero))) continue;
    }
    const auto to_object = [&](std::size_t column) {
      const V scaled = MulAddScalar(to_light.x, w[column],
                                    MulAddScalar(to_light.y, w[3 + column], MulScalar(to_light.z, w[6 + column])));
      return MulScalar(scaled, inverse_scale);
    };
    const Vec3 l{to_object(0), to_object(1), to_object(2)};
    const V facing = hn::Mul(hn::Max(Dot(n, l), zero), weight);
    out.diffuse.x = MulAddScalar(facing, source.intensity_over_pi[0], out.diffuse.x);
    out.diffuse.y = MulAddScalar(facing, source.intensity_over_pi[1], out.diffuse.y);
    out.diffuse.z = MulAddScalar(facing, source.intensity_over_pi[2], out.diffuse.z);
    if (!residual) continue;
    ShBasis(l, 2, [&](int k, V basis) {
      const V weighted = hn::Mul(basis, weight);
      for (int c = 0; c < 3; ++c) {
        V& sum = out.residual[3 * k + c];
        sum = MulAddScalar(weighted, source.intensity_over_pi[c], sum);
      }
    });
  }
}

/// ShadeTransfer()'s colour under the sources, too.
HWY_INLINE void AddSources(const Frame& frame, const ObjectFrame& object, const GaussianLanes& in, const Vec3& albedo,
                           Vec3& colour) {
  SourceLight light;
  SumSources(frame, object, in, true, light);
  colour.x = hn::MulAdd(albedo.x, light.diffuse.x, colour.x);
  colour.y = hn::MulAdd(albedo.y, light.diffuse.y, colour.y);
  colour.z = hn::MulAdd(albedo.z, light.diffuse.z, colour.z);
  for (int k = 0; k < 27; k += 3) {
    const int channel = ParameterLayout::kResidual + k;
    colour.x = hn::MulAdd(in.Load(channel), light.residual[k], colour.x);
    colour.y = hn::MulAdd(in.Load(channel + 1), light.residual[k + 1], colour.y);
    colour.z = hn::MulAdd(in.Load(channel + 2), light.residual[k + 2], colour.z);
  }
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
