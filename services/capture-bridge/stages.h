#pragma once

#include <cstddef>
#include <cstdint>

#include "capture-bridge/covisibility.h"
#include "device/buffer.h"

// The stages of sampling a round, in the order of a stream and on its device; those that return a number wait for it.
// All pointers are to that device's memory. Throw std::runtime_error when the device fails.
namespace splatbus::capture_bridge {

constexpr std::size_t kMaxViews = 255;  // ranks are bytes
constexpr std::size_t kRanks = 256;     // values of a rank, 0 (no sample) included
constexpr std::size_t kFaults = 4;      // kinds of PixelFault

/// What the host needs to know of a round's pixels.
struct RoundTally {
  std::uint32_t of_rank[kRanks];  ///< from 1 on
  std::uint32_t faults[kMaxViews][kFaults];
};

/// A round's pixels: those of view v begin at v * view_pixels, row-major.
struct RoundPixels {
  const PixelView* views = nullptr;
  std::uint32_t view_count = 0;
  std::uint32_t view_pixels = 0;  ///< of each view, all of one size
  FarField far_field;
  bool movement = false;      ///< some view has objects that stand elsewhere in the round's frame
  float* depth_m = nullptr;   ///< along the camera's z; 0: no surface
  float* cosine = nullptr;    ///< between normal and direction to the camera
  Surfel* surfels = nullptr;  ///< of samples that are seen at min_cosine or better
  bool* edges = nullptr;      ///< beside a discontinuity
  SurfaceRank* ranks = nullptr;
  RoundTally* tally = nullptr;

  [[nodiscard]] std::uint32_t pixels() const { return view_count * view_pixels; }
};

/// Checks and measures all pixels: depth_m, cosine, surfels, edges; adds to tally->faults.
void measure_surfels(device::StreamView stream, const RoundPixels& round, float min_cosine);

/// Ranks samples across cameras, and adds to tally->of_rank. At a surface point every camera that sees it is ranked by
/// depth / (focal length * cosine), the longest extent of its pixel on the surface: small is near and not oblique. The
/// ranking depends on nothing but the point, so that neighbouring samples of different cameras agree on it: when the
/// samples of rank 1 to k are kept, every surface that is seen by k cameras is covered k times, and none is left out. A
/// camera sees a point where its own pixel there holds a valid sample of the same object on the same tangent plane.
/// Objects that moved between the views' frames are compared at their places in each view.
void rank_across_cameras(device::StreamView stream, const RoundPixels& round, const CullOptions& options);

/// Surfels that culling has left, in the order of pixels.
struct Candidates {
  std::uint32_t count = 0;
  std::uint32_t* pixel = nullptr;  ///< [count] among all views'
  float* position = nullptr;       ///< [count, 3] in the round's frame
  float* area_m2 = nullptr;        ///< [count] of surface that it stands for
  float* weight = nullptr;         ///< [count] what it counts for when samples are too many
};

/// Surface that is farther from its camera than this counts by the angle that it covers, not by its area: what lies far
/// away is coarse, and leaves the budget to what is near.
constexpr float kNearSurface_m = 8;

/// The surfels of rank 1 to cameras_per_surface, of which there are `candidates.count`.
void select_candidates(device::StreamView stream, const RoundPixels& round, int cameras_per_surface,
                       const Candidates& candidates);

/// Chooses at most `budget` points so that what is left covers the surface evenly; returns how many, and `kept` begins
/// with their indices in Morton order. Point i of `position` [count, 3] stands for `area_m2[i]` of surface; it is kept
/// with probability min(1, area / T), T such that the budget is met, and the choice is systematic along a Morton curve:
/// every stretch of the curve keeps its share, to one point, so that there are neither clumps nor holes. Deterministic,
/// and the same on every device: areas and shares are summed as integers.
[[nodiscard]] std::uint32_t thin_to_budget(device::StreamView stream, const float* position, const float* area_m2,
                                           std::uint32_t count, std::size_t budget,
                                           device::Buffer<std::uint32_t>& kept);

/// Linear values of a byte under the sRGB curve.
struct LinearTable {
  float value[256];
};

/// A round's samples: channels of schemas/capture.fbs, CaptureInput.
struct Samples {
  std::uint32_t count = 0;
  float *position = nullptr, *normal = nullptr, *albedo = nullptr, *color = nullptr;
  float* spacing_m = nullptr;
  std::uint32_t* object_id = nullptr;
  std::uint32_t* pixel = nullptr;  ///< [count] where it was seen, among all views' pixels
};

/// Everything of the samples but their spacing, of which it leaves the fallback: sqrt(area) * spacing_growth. Sample k
/// is candidate kept[k].
void write_samples(device::StreamView stream, const RoundPixels& round, const Candidates& candidates,
                   const std::uint32_t* kept, float spacing_growth, const LinearTable* linear, const Samples& samples);

/// Metres between each point and its neighbours on the same surface: the mean distance to the four nearest whose
/// normals are within 60 degrees. On a square grid that is the grid's step. A point with fewer than two such neighbours
/// keeps the fallback that `spacing_m` holds; no spacing is larger than four times its fallback (a lone sample far from
/// everything). Quick when the points come in Morton order. `position` and `normal` are [count, 3].
void estimate_spacing(device::StreamView stream, const float* position, const float* normal, std::uint32_t count,
                      float* spacing_m);

}  // namespace splatbus::capture_bridge
