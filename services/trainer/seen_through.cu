#include <algorithm>
#include <cmath>

#include "device/buffer.h"
#include "device/parallel.h"
#include "gaussians/portable.h"
#include "trainer/seen_through.h"

namespace splatbus::trainer {

namespace {

constexpr int kStride_px = 4;  // from one pixel that is looked at to the next
/// Parts of a depth: between neighbours on one surface, and beyond which what is seen lies behind it.
constexpr float kSmoothPart = 0.05F, kBehindPart = 0.03F;
/// A pixel of a surface is to be at least that large in the other picture, or it might fall between what that samples.
constexpr float kLeastPixel_px = 0.5F;

struct DepthView {
  math::Rigid world_from_camera, camera_from_world;
  float fx, fy, cx, cy, near_m, far_m;
  int width, height;
  const float* depth;
  const std::uint8_t* mask;  ///< or null

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t samples() const {
    return static_cast<std::uint32_t>(width / kStride_px) * static_cast<std::uint32_t>(height / kStride_px);
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool has(int column, int row) const {
    return column >= 0 && column < width && row >= 0 && row < height;
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::size_t at(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column);
  }
};

DepthView view_of(const TrainingView& view) {
  const Camera& camera = view.camera;
  return {.world_from_camera = portable(camera.world_from_camera),
          .camera_from_world = portable(inverse(camera.world_from_camera)),
          .fx = camera.fx,
          .fy = camera.fy,
          .cx = camera.cx,
          .cy = camera.cy,
          .near_m = camera.near_m,
          .far_m = camera.far_m,
          .width = static_cast<int>(camera.width),
          .height = static_cast<int>(camera.height),
          .depth = view.depth.data(),
          .mask = view.mask.empty() ? nullptr : view.mask.data()};
}

struct JudgeSample {
  DepthView newer;
  const DepthView* kept;
  std::uint32_t samples_a_view;  ///< at most
  SeenThrough* counts;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t pair = i / samples_a_view, sample = i % samples_a_view;
    const DepthView& other = kept[pair / 2];
    const bool forward = pair % 2 == 0;
    judge(forward ? newer : other, forward ? other : newer, sample, counts[pair / 2]);
  }

 private:
  static SPLATBUS_PORTABLE_MEMBER void judge(const DepthView& from, const DepthView& to, std::uint32_t sample,
                                             SeenThrough& count) {
    if (sample >= from.samples()) return;
    const auto columns = static_cast<std::uint32_t>(from.width / kStride_px);
    const int column = static_cast<int>(sample % columns) * kStride_px + kStride_px / 2;
    const int row = static_cast<int>(sample / columns) * kStride_px + kStride_px / 2;
    const float depth_m = from.depth[from.at(column, row)];
    if (!is_smooth(from, column, row, depth_m)) return;
    const math::Vec3 in_camera{(static_cast<float>(column) + 0.5F - from.cx) / from.fx * depth_m,
                               (static_cast<float>(row) + 0.5F - from.cy) / from.fy * depth_m, depth_m};
    const math::Vec3 at = transformed(to.camera_from_world, transformed(from.world_from_camera, in_camera));
    // Beyond its far plane it sees nothing at all.
    if (!(at.z > to.near_m && (1 + kBehindPart) * at.z < to.far_m)) return;
    if (!(depth_m * to.fx >= kLeastPixel_px * at.z * from.fx)) return;
    const float u = to.fx * at.x / at.z + to.cx, v = to.fy * at.y / at.z + to.cy;
    if (!(u >= 0 && u < static_cast<float>(to.width) && v >= 0 && v < static_cast<float>(to.height))) return;
    const float nearest_m = nearest(to, static_cast<int>(u), static_cast<int>(v));
    if (nearest_m < 0) return;
    device::atomic_add(&count.judged, 1U);
    if (nearest_m > (1 + kBehindPart) * at.z) device::atomic_add(&count.through, 1U);
  }

  static SPLATBUS_PORTABLE_MEMBER bool is_smooth(const DepthView& view, int column, int row, float depth_m) {
    if (!(depth_m > 0)) return false;
    for (int k = 0; k < 9; ++k) {
      const int x = column + k % 3 - 1, y = row + k / 3 - 1;
      if (!view.has(x, y) || (view.mask != nullptr && view.mask[view.at(x, y)] != 0)) return false;
      if (!(fabsf(view.depth[view.at(x, y)] - depth_m) <= kSmoothPart * depth_m)) return false;
    }
    return true;
  }

  /// Of a pixel and those about it; below 0: one of them says nothing.
  static SPLATBUS_PORTABLE_MEMBER float nearest(const DepthView& view, int column, int row) {
    float nearest_m = INFINITY;
    for (int k = 0; k < 9; ++k) {
      const int x = column + k % 3 - 1, y = row + k / 3 - 1;
      if (!view.has(x, y) || (view.mask != nullptr && view.mask[view.at(x, y)] != 0)) return -1;
      const float depth_m = view.depth[view.at(x, y)];
      if (depth_m != 0) nearest_m = math::smaller(nearest_m, depth_m);
    }
    return nearest_m;
  }
};

}  // namespace

std::vector<SeenThrough> seen_through(device::StreamView stream, const TrainingView& newer,
                                      std::span<const TrainingViewPtr> kept) {
  const DepthView newest = view_of(newer);
  std::uint32_t samples = newest.samples();
  std::vector<DepthView> views;
  for (const TrainingViewPtr& view : kept) {
    views.push_back(view_of(*view));
    samples = std::max(samples, views.back().samples());
  }
  if (samples == 0 || views.empty()) return std::vector<SeenThrough>(views.size());
  device::Buffer<DepthView> device_views(stream);
  device_views.assign(std::span<const DepthView>(views));
  device::Buffer<SeenThrough> counts(stream, views.size());
  counts.clear();
  device::for_each_index(stream, 2 * static_cast<std::uint32_t>(views.size()) * samples,
                         JudgeSample{newest, device_views.data(), samples, counts.data()});
  return counts.to_host();
}

}  // namespace splatbus::trainer
