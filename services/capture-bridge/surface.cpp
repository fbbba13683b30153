#include "capture-bridge/surface.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <mutex>

#include "capture-bridge/surface_math.h"

namespace splatbus::capture_bridge {

namespace {

constexpr std::size_t kRowsATask = 16;

void count(PixelFault fault, DropCounts& dropped) {
  dropped.not_finite += fault == PixelFault::NotFinite ? 1 : 0;
  dropped.bad_normal += fault == PixelFault::BadNormal ? 1 : 0;
  dropped.off_ray += fault == PixelFault::OffRay ? 1 : 0;
}

void check_row(const PixelView& view, std::uint32_t y, RoundSurface& surface, DropCounts& dropped) {
  std::size_t i = view.first_pixel + static_cast<std::size_t>(y) * view.width;
  for (std::uint32_t x = 0; x < view.width; ++x, ++i) {
    const SurfacePixel pixel = check_pixel(view, x, y);
    count(pixel.fault, dropped);
    surface.depth_m[i] = pixel.depth_m;
    surface.cosine[i] = pixel.cosine;
    surface.object_id[i] = pixel.object_id;
  }
}

void measure_row(const PixelView& view, const SurfaceOptions& options, std::uint32_t y, RoundSurface& surface) {
  const CheckedPixels checked{.depth_m = surface.depth_m.data() + view.first_pixel,
                              .object_id = surface.object_id.data() + view.first_pixel};
  std::size_t i = view.first_pixel + static_cast<std::size_t>(y) * view.width;
  for (std::uint32_t x = 0; x < view.width; ++x, ++i) {
    if (surface.depth_m[i] == 0 || surface.cosine[i] < options.min_cosine) continue;
    surface.texels[i] = measured_texel(view, checked, x, y);
  }
}

}  // namespace

DropCounts& DropCounts::operator+=(const DropCounts& other) {
  not_finite += other.not_finite;
  bad_normal += other.bad_normal;
  off_ray += other.off_ray;
  return *this;
}

std::string DropCounts::text() const {
  return fmt::format("{} not finite, {} with a normal that is not unit, {} that do not project to their pixel",
                     not_finite, bad_normal, off_ray);
}

RoundSurface analyse_surfaces(const PixelViews& views, const SurfaceOptions& options) {
  RoundSurface surface;
  surface.depth_m.resize(views.pixels);
  surface.cosine.resize(views.pixels);
  surface.object_id.resize(views.pixels);
  surface.texels.resize(views.pixels);
  surface.dropped.resize(views.views.size());
  std::mutex mutex;
  tbb::parallel_for(std::size_t{0}, views.views.size(), [&](std::size_t v) {
    const PixelView& view = views.views[v];
    using Rows = tbb::blocked_range<std::uint32_t>;
    tbb::parallel_for(Rows(0, view.height, kRowsATask), [&](const Rows& rows) {
      DropCounts dropped;
      for (std::uint32_t y = rows.begin(); y < rows.end(); ++y) check_row(view, y, surface, dropped);
      const std::scoped_lock lock(mutex);
      surface.dropped[v] += dropped;
    });
    tbb::parallel_for(Rows(0, view.height, kRowsATask), [&](const Rows& rows) {
      for (std::uint32_t y = rows.begin(); y < rows.end(); ++y) measure_row(view, options, y, surface);
    });
  });
  return surface;
}

}  // namespace splatbus::capture_bridge
