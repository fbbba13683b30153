#include "device/parallel.h"
#include "trainer/farthest_surfaces.h"

namespace splatbus::trainer {

namespace {

struct FindFarthest {
  const float* depth_m;
  int width, height, columns;
  float* farthest_m;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t square) const {
    constexpr int kSide = static_cast<int>(kSurfaceSquare_px);
    const int x = static_cast<int>(square) % columns * kSide, y = static_cast<int>(square) / columns * kSide;
    float farthest = 0;
    for (int row = max_of(0, y - 1); row < min_of(height, y + kSide + 1); ++row) {
      for (int column = max_of(0, x - 1); column < min_of(width, x + kSide + 1); ++column) {
        const float depth =
            depth_m[static_cast<std::size_t>(row) * static_cast<std::size_t>(width) + static_cast<std::size_t>(column)];
        farthest = depth > 0 ? math::larger(depth, farthest) : INFINITY;
        if (!math::is_finite(farthest)) {
          farthest_m[square] = INFINITY;
          return;
        }
      }
    }
    farthest_m[square] = farthest;
  }

 private:
  static SPLATBUS_PORTABLE_MEMBER int min_of(int a, int b) { return a < b ? a : b; }
  static SPLATBUS_PORTABLE_MEMBER int max_of(int a, int b) { return a > b ? a : b; }
};

}  // namespace

void find_farthest_surfaces(device::StreamView stream, const float* depth_m, std::uint32_t width, std::uint32_t height,
                            float* farthest_m) {
  device::for_each_index(stream, static_cast<std::uint32_t>(surface_squares(width, height)),
                         FindFarthest{depth_m, static_cast<int>(width), static_cast<int>(height),
                                      static_cast<int>(FarthestSurfaces::squares(width)), farthest_m});
}

}  // namespace splatbus::trainer
