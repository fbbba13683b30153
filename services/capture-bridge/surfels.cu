#include <thrust/copy.h>

#include "capture-bridge/stages.h"
#include "device/parallel.h"

namespace splatbus::capture_bridge {

namespace {

struct CheckPixel {
  RoundPixels round;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t v = i / round.view_pixels, in_view = i % round.view_pixels;
    const PixelView& view = round.views[v];
    const SurfacePixel pixel = check_pixel(view, in_view % view.width, in_view / view.width);
    round.depth_m[i] = pixel.depth_m;
    round.cosine[i] = pixel.cosine;
    if (pixel.fault != PixelFault::None) device::atomic_add(&round.tally->faults[v][static_cast<int>(pixel.fault)], 1U);
  }
};

struct MeasurePixel {
  RoundPixels round;
  float min_cosine;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t v = i / round.view_pixels, in_view = i % round.view_pixels;
    const PixelView& view = round.views[v];
    Surfel surfel;
    bool edge = false;
    if (view.object_id[in_view] == 0) {
      surfel = far_surfel(view, round.far_field, in_view % view.width, in_view / view.width);
    } else if (view.object_id[in_view] != round.far_field.frame_id && round.depth_m[i] != 0 &&
               !(round.cosine[i] < min_cosine)) {
      const float* const depth_m = round.depth_m + static_cast<std::size_t>(v) * round.view_pixels;
      surfel = measured_surfel(view, depth_m, in_view % view.width, in_view / view.width, edge);
      const MovedObject* const moved = find_moved(view, surfel.object_id);
      if (moved != nullptr && moved->gone) surfel = {};
    }
    round.surfels[i] = surfel;
    round.edges[i] = edge;
  }
};

/// Pixels of a tile's side: what other cameras see of a tile fits into the smallest cache, and a tile's pixels are
/// ranked one after the other, or side by side.
constexpr std::uint32_t kTile = 8;

/// Pixel `i` of a picture when its tiles are counted row by row, and the pixels of a tile.
SPLATBUS_PORTABLE std::uint32_t pixel_in_tiles(std::uint32_t width, std::uint32_t height, std::uint32_t i) {
  const std::uint32_t strip = i / (kTile * width), in_strip = i % (kTile * width);
  const std::uint32_t rows_left = height - strip * kTile, rows = rows_left < kTile ? rows_left : kTile;
  const std::uint32_t tile = in_strip / (kTile * rows), in_tile = in_strip % (kTile * rows);
  const std::uint32_t columns_left = width - tile * kTile, columns = columns_left < kTile ? columns_left : kTile;
  return (strip * kTile + in_tile / columns) * width + tile * kTile + in_tile % columns;
}

struct RankPixel {
  RoundPixels round;
  CullOptions options;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t own = i / round.view_pixels;
    const PixelView& view = round.views[own];
    const std::uint32_t pixel =
        own * round.view_pixels + pixel_in_tiles(view.width, view.height, i % round.view_pixels);
    const Surfel point = round.surfels[pixel];
    SurfaceRank rank;
    if (point.footprint_m != 0 && point.object_id == round.far_field.frame_id) {
      rank = {.rank = 1, .seen_by = 1};  // cameras have no distance there that tells the best of them
    } else if (point.footprint_m != 0) {
      const CovisibilityTest test(round.views, round.view_pixels, round.surfels, round.edges, round.movement, options);
      const auto sees = [&](std::uint32_t other, float& found) { return test.sees(other, own, point, found); };
      rank = rank_among(round.view_count, own, test.own_extent(own, pixel), options.similar, sees);
    }
    round.ranks[pixel] = rank;
  }
};

/// Counts a stretch of pixels, equal neighbours at once: all items add to the same few numbers.
struct CountRanks {
  static constexpr std::uint32_t kPixels = 256;
  RoundPixels round;
  std::uint32_t pixels;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t stretch) const {
    const std::uint32_t first = stretch * kPixels;
    const std::uint32_t end = first + kPixels < pixels ? first + kPixels : pixels;
    std::uint32_t rank = 0, run = 0;
    for (std::uint32_t i = first; i < end; ++i) {
      const std::uint32_t next = round.ranks[i].rank;
      if (next != rank) {
        add(rank, run);
        rank = next;
        run = 0;
      }
      ++run;
    }
    add(rank, run);
  }

 private:
  SPLATBUS_PORTABLE_MEMBER void add(std::uint32_t rank, std::uint32_t run) const {
    if (rank != 0) device::atomic_add(&round.tally->of_rank[rank], run);
  }
};

struct IsKept {
  const SurfaceRank* ranks;
  int cameras_per_surface;
  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint32_t pixel) const {
    const int rank = ranks[pixel].rank;
    return rank != 0 && rank <= cameras_per_surface;
  }
};

struct GatherCandidate {
  RoundPixels round;
  int cameras_per_surface;
  Candidates candidates;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t c) const {
    const std::uint32_t pixel = candidates.pixel[c];
    const Surfel surfel = round.surfels[pixel];
    const MovedObject* moved = find_moved(round.views[pixel / round.view_pixels], surfel.object_id);
    const Vec3 position = moved == nullptr ? surfel.position : transformed(moved->round_from_view, surfel.position);
    const float footprint_m = moved == nullptr ? surfel.footprint_m : surfel.footprint_m * moved->round_from_view.scale;
    candidates.position[3 * std::size_t{c}] = position.x;
    candidates.position[3 * std::size_t{c} + 1] = position.y;
    candidates.position[3 * std::size_t{c} + 2] = position.z;
    // The cameras that keep theirs have about the same footprint, and share the surface.
    const int seen_by = round.ranks[pixel].seen_by;
    const float area_m2 =
        footprint_m * footprint_m / static_cast<float>(cameras_per_surface < seen_by ? cameras_per_surface : seen_by);
    const float far = round.depth_m[pixel] / kNearSurface_m;
    candidates.area_m2[c] = area_m2;
    candidates.weight[c] = area_m2 / larger(1, far * far);
  }
};

}  // namespace

void measure_surfels(device::StreamView stream, const RoundPixels& round, float min_cosine) {
  device::for_each_index(stream, round.pixels(), CheckPixel{round});
  device::for_each_index(stream, round.pixels(), MeasurePixel{round, min_cosine});
}

void rank_across_cameras(device::StreamView stream, const RoundPixels& round, const CullOptions& options) {
  device::for_each_index(stream, round.pixels(), RankPixel{round, options});
  const std::uint32_t stretches = (round.pixels() + CountRanks::kPixels - 1) / CountRanks::kPixels;
  device::for_each_index(stream, stretches, CountRanks{round, round.pixels()});
}

void select_candidates(device::StreamView stream, const RoundPixels& round, int cameras_per_surface,
                       const Candidates& candidates) {
  if (candidates.count == 0) return;
  const thrust::counting_iterator<std::uint32_t> first(0);
  device::with_policy(stream, [&](auto&& policy) {
    thrust::copy_if(policy, first, first + round.pixels(), candidates.pixel, IsKept{round.ranks, cameras_per_surface});
  });
  device::for_each_index(stream, candidates.count, GatherCandidate{round, cameras_per_surface, candidates});
}

}  // namespace splatbus::capture_bridge
