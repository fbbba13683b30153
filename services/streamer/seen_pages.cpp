#include "streamer/seen_pages.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace splatbus::streamer {

namespace {

constexpr float kSide_px = 128;  // of the small picture, the longer one
constexpr float kCovers = 1.1F;  // of a disc's radius: points are scattered, and discs of the surface's area leave gaps

/// A page's point in the small picture.
struct Disc {
  std::uint32_t page = 0;
  float x_px = 0, y_px = 0, z_m = 0, radius_px = 0;
};

/// The nearest page in each pixel.
class Nearest {
 public:
  Nearest(int width, int height)
      : width_(width), height_(height), pixels_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height)) {}
  void add(const Disc& disc) {
    const auto column = [&](float x) { return static_cast<int>(std::clamp(x, -1.0F, static_cast<float>(width_))); };
    const auto row = [&](float y) { return static_cast<int>(std::clamp(y, -1.0F, static_cast<float>(height_))); };
    const int x0 = std::max(column(disc.x_px - disc.radius_px), 0), y0 = std::max(row(disc.y_px - disc.radius_px), 0);
    const int x1 = std::min(column(disc.x_px + disc.radius_px), width_ - 1),
              y1 = std::min(row(disc.y_px + disc.radius_px), height_ - 1);
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        Pixel& pixel = pixels_[static_cast<std::size_t>(y * width_ + x)];
        if (disc.z_m < pixel.z_m) pixel = {disc.z_m, disc.page};
      }
    }
  }
  void add_areas(std::unordered_map<std::uint32_t, float>& areas, float of_pixel) const {
    for (const Pixel& pixel : pixels_) {
      if (pixel.z_m < kNothing) areas[pixel.page] += of_pixel;
    }
  }

 private:
  static constexpr float kNothing = std::numeric_limits<float>::max();
  struct Pixel {
    float z_m = kNothing;
    std::uint32_t page = 0;
  };

  int width_, height_;
  std::vector<Pixel> pixels_;
};

}  // namespace

std::unordered_map<std::uint32_t, float> seen_areas_px2(std::span<const stream::OfferedPage> pages,
                                                        const Camera& camera, const ObjectTransforms& objects) {
  const auto width = static_cast<float>(camera.width), height = static_cast<float>(camera.height);
  const float small = kSide_px / std::max(width, height);
  const int columns = std::max(1, static_cast<int>(width * small)),
            rows = std::max(1, static_cast<int>(height * small));
  const Rigid camera_from_world = inverse(camera.world_from_camera);
  std::unordered_map<std::uint32_t, float> areas;
  Nearest nearest(columns, rows);
  for (const stream::OfferedPage& page : pages) {
    if (!page.surfels || page.surfels->points_m.empty() || page.object_id == kFarFieldFrame) continue;
    ObjectTransform world_from_page;
    if (page.object_id != kWorldFrame) {
      const auto object = objects.find(page.object_id);
      if (object == objects.end()) continue;
      world_from_page = object->second;
    }
    areas[page.page] = 0;
    const float radius_m = page.surfels->radius_m * world_from_page.scale;
    for (const glm::vec3& point : page.surfels->points_m) {
      const glm::vec3 p = camera_from_world * (world_from_page * point);
      if (p.z < camera.near_m) continue;
      const float x = (camera.fx * p.x / p.z + camera.cx) * small, y = (camera.fy * p.y / p.z + camera.cy) * small;
      const float radius_px = kCovers * radius_m * std::max(camera.fx, camera.fy) / p.z * small;
      nearest.add({page.page, x, y, p.z, radius_px});
    }
  }
  nearest.add_areas(areas, 1 / (small * small));
  return areas;
}

}  // namespace splatbus::streamer
