// The projection of Gaussians, 16 at a time, shared by forward and backward; included once a Highway target.
#if defined(SPLATBUS_RASTER_PROJECTION_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef SPLATBUS_RASTER_PROJECTION_INL_H
#undef SPLATBUS_RASTER_PROJECTION_INL_H
#else
#define SPLATBUS_RASTER_PROJECTION_INL_H
#endif

#include <algorithm>

#include "hwy/cache_control.h"
#include "hwy/contrib/math/math-inl.h"
#include "raster/cpu/frame.h"
#include "raster/cpu/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace splatbus::raster::cpu::HWY_NAMESPACE {

/// Gaussians i .. i + n - 1, which lie in one page.
struct GaussianLanes {
  const GaussiansView& gaussians;
  std::size_t i, n;
  std::size_t end;     ///< of the piece that is worked on
  std::size_t offset;  ///< of Gaussian i in every channel

  HWY_INLINE GaussianLanes(const GaussiansView& view, std::size_t first, std::size_t count, std::size_t piece_end)
      : gaussians(view), i(first), n(count), end(piece_end), offset(view.offset(first)) {}

  [[nodiscard]] HWY_INLINE V Load(int channel) const { return LoadFirst(F(), gaussians.plane(channel) + offset, n); }
};

/// Fetches a vector's Gaussians of channels [begin, end): they are more streams than a core follows by itself. Where
/// channels are not aligned a vector's first line is the last of the vector before.
HWY_INLINE void PrefetchChannels(const GaussiansView& gaussians, std::size_t i, std::size_t piece_end, int begin,
                                 int end) {
  const std::size_t last = gaussians.offset(std::min(i + hn::Lanes(F()), piece_end) - 1);
  for (int channel = begin; channel < end; ++channel) hwy::Prefetch(gaussians.plane(channel) + last);
}

/// The same, a few channels at a time between other work: a core has room for a dozen or so lines on their way, and
/// waits when it asks for more.
class ChannelFetch {
 public:
  ChannelFetch() = default;
  ChannelFetch(const GaussianLanes& in, int begin, int end)
      : gaussians_(&in.gaussians), last_(in.offset + in.n - 1), channel_(begin), end_(end) {}
  HWY_INLINE void Some(int most) {
    const int stop = std::min(channel_ + most, end_);
    for (; channel_ < stop; ++channel_) hwy::Prefetch(gaussians_->plane(channel_) + last_);
  }
  HWY_INLINE void Rest() { Some(end_ - channel_); }

 private:
  const GaussiansView* gaussians_ = nullptr;
  std::size_t last_ = 0;
  int channel_ = 0, end_ = 0;
};

struct Vec3 {
  V x, y, z;
};
HWY_INLINE V Dot(const Vec3& a, const Vec3& b) {
  return hn::MulAdd(a.x, b.x, hn::MulAdd(a.y, b.y, hn::Mul(a.z, b.z)));
}
HWY_INLINE Vec3 Cross(const Vec3& a, const Vec3& b) {
  return {hn::MulSub(a.y, b.z, hn::Mul(a.z, b.y)), hn::MulSub(a.z, b.x, hn::Mul(a.x, b.z)),
          hn::MulSub(a.x, b.y, hn::Mul(a.y, b.x))};
}
HWY_INLINE Vec3 Scale(const Vec3& a, V s) {
  return {hn::Mul(a.x, s), hn::Mul(a.y, s), hn::Mul(a.z, s)};
}
HWY_INLINE Vec3 Add3(const Vec3& a, const Vec3& b) {
  return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}

/// The mean in the camera's frame.
HWY_INLINE Vec3 CameraPoint(const ObjectFrame& object, const Vec3& mean) {
  const auto& w = object.camera_from_object;
  const auto row = [&](std::size_t r) {
    return MulAddScalar(
        mean.x, w[3 * r],
        MulAddScalar(mean.y, w[3 * r + 1], MulAddScalar(mean.z, w[3 * r + 2], Splat1(object.translation[r]))));
  };
  return {row(0), row(1), row(2)};
}

/// Every intermediate of the projection of a Gaussian. The 2D covariance before blur is M M^T with the rows of
/// M = J W R diag(s); its determinant is |m0 x m1|^2 (Cauchy-Binet), which keeps its precision for thin Gaussians where
/// a c - b^2 does not.
struct Projection {
  Vec3 mean, camera;          // object's frame, camera's frame
  V inverse_z, tan_x, tan_y;  // tangents after the clamp
  M free_x, free_y;           // not clamped
  V qw, qx, qy, qz, inverse_norm;
  Vec3 r0, r1, r2;  // rows of R
  Vec3 scale;
  Vec3 t0, t1, n0, n1, m0, m1;  // rows of T = J W, N = T R, M = N diag(s)
  V a, b, c;                    // covariance with blur
  Vec3 minor;                   // m0 x m1
  V det_sharp, det_blurred, opacity, alpha;
  V x, y;  // pixels
};

HWY_INLINE Projection Project(const Frame& frame, const ObjectFrame& object, const GaussianLanes& in) {
  const F f;
  const Camera& camera = frame.camera;
  Projection p;
  p.mean = {in.Load(0), in.Load(1), in.Load(2)};
  p.camera = CameraPoint(object, p.mean);
  p.inverse_z = hn::Div(Splat1(1.0F), p.camera.z);
  const V tan_x = hn::Mul(p.camera.x, p.inverse_z), tan_y = hn::Mul(p.camera.y, p.inverse_z);
  p.x = MulAddScalar(tan_x, camera.fx, Splat1(camera.cx));
  p.y = MulAddScalar(tan_y, camera.fy, Splat1(camera.cy));
  const V low_x = Splat1(frame.tan_limit_x_low), high_x = Splat1(frame.tan_limit_x_high);
  const V low_y = Splat1(frame.tan_limit_y_low), high_y = Splat1(frame.tan_limit_y_high);
  p.free_x = hn::And(hn::Ge(tan_x, low_x), hn::Le(tan_x, high_x));
  p.free_y = hn::And(hn::Ge(tan_y, low_y), hn::Le(tan_y, high_y));
  p.tan_x = hn::Min(hn::Max(tan_x, low_x), high_x);
  p.tan_y = hn::Min(hn::Max(tan_y, low_y), high_y);

  // T = J W.
  const auto& w = object.camera_from_object;
  const V jx = MulScalar(p.inverse_z, camera.fx), jy = MulScalar(p.inverse_z, camera.fy);
  const V jxz = hn::Neg(hn::Mul(jx, p.tan_x)), jyz = hn::Neg(hn::Mul(jy, p.tan_y));
  const auto t_entry = [&](V j, V jz, std::size_t row, std::size_t column) {
    return MulAddScalar(j, w[3 * row + column], MulScalar(jz, w[6 + column]));
  };
  p.t0 = {t_entry(jx, jxz, 0, 0), t_entry(jx, jxz, 0, 1), t_entry(jx, jxz, 0, 2)};
  p.t1 = {t_entry(jy, jyz, 1, 0), t_entry(jy, jyz, 1, 1), t_entry(jy, jyz, 1, 2)};

  // R.
  const V qw = in.Load(6), qx = in.Load(7), qy = in.Load(8), qz = in.Load(9);
  const V norm2 = hn::MulAdd(qw, qw, hn::MulAdd(qx, qx, hn::MulAdd(qy, qy, hn::Mul(qz, qz))));
  p.inverse_norm = hn::Div(Splat1(1.0F), hn::Sqrt(norm2));
  p.qw = hn::Mul(qw, p.inverse_norm);
  p.qx = hn::Mul(qx, p.inverse_norm);
  p.qy = hn::Mul(qy, p.inverse_norm);
  p.qz = hn::Mul(qz, p.inverse_norm);
  const V one = Splat1(1.0F);
  const V x2 = hn::Add(p.qx, p.qx), y2 = hn::Add(p.qy, p.qy), z2 = hn::Add(p.qz, p.qz);
  const V xx = hn::Mul(p.qx, x2), yy = hn::Mul(p.qy, y2), zz = hn::Mul(p.qz, z2);
  const V xy = hn::Mul(p.qx, y2), xz = hn::Mul(p.qx, z2), yz = hn::Mul(p.qy, z2);
  const V wx = hn::Mul(p.qw, x2), wy = hn::Mul(p.qw, y2), wz = hn::Mul(p.qw, z2);
  p.r0 = {hn::Sub(one, hn::Add(yy, zz)), hn::Sub(xy, wz), hn::Add(xz, wy)};
  p.r1 = {hn::Add(xy, wz), hn::Sub(one, hn::Add(xx, zz)), hn::Sub(yz, wx)};
  p.r2 = {hn::Sub(xz, wy), hn::Add(yz, wx), hn::Sub(one, hn::Add(xx, yy))};

  p.scale = {hn::Exp(f, in.Load(3)), hn::Exp(f, in.Load(4)), hn::Exp(f, in.Load(5))};
  const auto times_rotation = [&](const Vec3& t) {
    return Vec3{hn::MulAdd(t.x, p.r0.x, hn::MulAdd(t.y, p.r1.x, hn::Mul(t.z, p.r2.x))),
                hn::MulAdd(t.x, p.r0.y, hn::MulAdd(t.y, p.r1.y, hn::Mul(t.z, p.r2.y))),
                hn::MulAdd(t.x, p.r0.z, hn::MulAdd(t.y, p.r1.z, hn::Mul(t.z, p.r2.z)))};
  };
  const auto times_scale = [&](const Vec3& n) {
    return Vec3{hn::Mul(n.x, p.scale.x), hn::Mul(n.y, p.scale.y), hn::Mul(n.z, p.scale.z)};
  };
  p.n0 = times_rotation(p.t0);
  p.n1 = times_rotation(p.t1);
  p.m0 = times_scale(p.n0);
  p.m1 = times_scale(p.n1);

  const V blur = Splat1(frame.options.blur_px2);
  const V a_sharp = Dot(p.m0, p.m0), c_sharp = Dot(p.m1, p.m1);
  p.b = Dot(p.m0, p.m1);
  p.a = hn::Add(a_sharp, blur);
  p.c = hn::Add(c_sharp, blur);
  p.minor = Cross(p.m0, p.m1);
  p.det_sharp = Dot(p.minor, p.minor);
  p.det_blurred = hn::MulAdd(blur, hn::Add(a_sharp, p.c), p.det_sharp);
  p.opacity = hn::Div(one, hn::Add(one, hn::Exp(f, hn::Neg(in.Load(ParameterLayout::kOpacityLogit)))));
  p.alpha = p.opacity;
  if (frame.options.antialias) p.alpha = hn::Mul(p.opacity, hn::Sqrt(hn::Div(p.det_sharp, p.det_blurred)));
  return p;
}

}  // namespace splatbus::raster::cpu::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();
#endif
