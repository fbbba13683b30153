#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "expander/cell.h"
#include "gaussians/pages.h"

// The expander's bulk work, written once for both devices (point_grid.cu, sample_selector.cu). Pointers are to memory
// of the stream's device unless they are spans. Both devices give the same cells and select the same samples.
// Everything throws std::runtime_error or std::bad_alloc when memory or the device fails.
namespace splatbus::expander {

/// The samples of a round: surface points from input pictures, world frame, linear colours.
struct Samples {
  math::Vec3 *position, *normal, *albedo, *color;  ///< normal: unit; color: lit
  float* spacing_m;                                ///< between neighbours on the surface; 0: the sample is invalid
  std::uint32_t* object_id;
  std::uint32_t count;
};
inline constexpr std::size_t kSampleBytes = 4 * sizeof(math::Vec3) + sizeof(float) + sizeof(std::uint32_t);

/// Lays the arrays of `count` samples out in one block of count * kSampleBytes.
[[nodiscard]] Samples samples_at(std::byte* memory, std::uint32_t count);

/// What a valid sample keeps within.
inline constexpr float kMaxSpacing_m = 1000;
inline constexpr float kUnitTolerance = 0.05F;  ///< of a normal's length

/// Normalises and clamps samples, marks those that are not finite or whose normal or spacing make no sense as invalid,
/// and returns how many those are.
[[nodiscard]] std::uint32_t validate(device::StreamView stream, const Samples& samples);

/// New Gaussians as model/insert carries them, channel by channel ([channels][count]) in one block. Frames and units:
/// schemas/model.fbs, ModelInsert.
struct InsertChannels {
  float *mean, *log_scale, *rotation, *opacity_logit, *albedo, *normal, *visibility;
  std::uint32_t* object_id;
  std::uint32_t count;
};
inline constexpr std::size_t kInsertBytes = 18 * sizeof(float) + sizeof(std::uint32_t);

/// `memory` is aligned to 4 bytes and has count * kInsertBytes of room.
[[nodiscard]] InsertChannels insert_channels_at(std::byte* memory, std::uint32_t count);

struct CellCount {
  CellKey key;
  std::uint32_t count = 0;
};

/// A moving object at the time of the round.
struct ObjectFrame {
  std::uint32_t id = 0;
  math::Similarity object_from_world;
};

/// Frames of a scene's objects, ascending by id, none of id 0, in memory of the device.
struct ObjectFrames {
  const ObjectFrame* objects = nullptr;
  std::uint32_t count = 0;

  /// Null for what stands still.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER const ObjectFrame* find(std::uint32_t id) const {
    std::uint32_t first = 0, end = count;
    while (first < end) {
      const std::uint32_t middle = first + (end - first) / 2;
      objects[middle].id < id ? first = middle + 1 : end = middle;
    }
    return first < count && objects[first].id == id ? objects + first : nullptr;
  }
  /// Of the frame's own unit of length.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float metres_per_unit(std::uint32_t id) const {
    const ObjectFrame* const object = find(id);
    return object == nullptr ? 1.0F : 1.0F / object->object_from_world.scale;
  }
};

/// Somebody for whom the model is made, world.
struct Viewpoint {
  math::Vec3 position, ahead;  ///< where he is now, and where he will be if he goes on as he does
  float focal_px = 0;          ///< of his pictures
};

inline constexpr float kSameSurfaceCosine = 0.5F;  ///< between normals of points that can cover one another

/// Lengths without a unit are of a sample's spacing.
struct SelectOptions {
  float reach_m = 60;             ///< what lies nearer to a viewpoint is modelled, however small it is in its pictures
  float min_pixels = 1;           ///< beyond, what is at least this large there
  std::uint32_t min_samples = 4;  ///< a cell counts as seen with this many in it and beside it
  float new_distance = 1;         ///< what is modelled nearer than this covers a sample
  float fill_distance = 0.75F;    ///< in a cell that is being filled only what is nearer than this does
  float hole_distance = 1.4F;     ///< where nothing is modelled nearer than this there is a hole, which is filled
  float refine_factor = 1.4F;     ///< a cell is filled again when its samples are finer than before by this
  float refine_share = 0.5F;      ///< or when this share of them, min_samples at least, is not covered; or at a hole
  std::uint32_t room = 0xFFFFFFFF;  ///< at most this many are selected, the first of the round
};

struct InitialOptions {
  float scale = 0.42F;    ///< standard deviation along the surface, of the spacing
  float flatness = 0.2F;  ///< the axis along the normal, of the others
  float opacity = 0.95F;
};

/// Light of a round. `ambient`: what a white surface reflects, as coefficients of 1, y, z, x, xy, yz,
/// 2zz - xx - yy, xz, xx - yy of its normal.
struct LightTerms {
  math::Vec3 ambient[9];
  math::Vec3 sun_direction, sun_irradiance;
};

inline constexpr float kMinSpacing_m = 1e-4F;
inline constexpr float kMinSunPart = 0.02F;  ///< luminance; below this the sun's visibility cannot be told

class FilledCells;
class PointGrid;

/// Of a cell's samples.
struct CellSums {
  std::uint32_t spacing;           ///< of the cell's edge, fixed-point
  std::uint32_t uncovered, holes;  ///< the former with the latter
};

/// Why samples were selected.
struct InsertReasons {
  std::uint32_t bare = 0;  ///< nothing that faces the same way is modelled within three spacings or more: new ground
  std::uint32_t hole = 0;  ///< nothing is within the hole's distance, but something is beyond
  std::uint32_t fill = 0;  ///< a cell is filled more densely, or more finely than before
};

/// Finds the samples that the model lacks and makes Gaussians of them. Keeps its memory from round to round. Not
/// thread-safe.
class SampleSelector {
 public:
  SampleSelector(device::StreamView stream, float cell_size_m);

  /// Takes a round up: which of its samples are candidates, and which cells they lie in, those of each spacing in cells
  /// of a size for it. Samples of an object of `objects` (ascending by id, none of id 0) live in the object's frame,
  /// all others stand still and live in the world's. Without viewpoints, all samples are candidates.
  void bin(const Samples& samples, std::span<const ObjectFrame> objects, std::span<const Viewpoint> viewpoints,
           const SelectOptions& options);

  /// Of the round that was taken up, and its cells' neighbours of the same size: whatever is modelled there matters.
  [[nodiscard]] const std::vector<CellCount>& search_cells() const { return search_cells_; }
  /// The candidates by cells of kReportLevel, ascending.
  [[nodiscard]] const std::vector<CellCount>& cells() const { return report_; }
  /// Samples that lie too far from their frame's origin for any cell.
  [[nodiscard]] std::uint32_t beyond() const { return beyond_; }
  /// Of the last select(), whatever it had room for.
  [[nodiscard]] const InsertReasons& reasons() const { return reasons_; }

  /// Selects candidates of cells that are seen, that no point which faces the same way covers, and that lie in a hole
  /// or in a cell that is to be filled (FilledCells). Coarser points count among the finer ones that join them.
  /// `modelled` has all of search_cells(). Returns how many are selected.
  [[nodiscard]] std::uint32_t select(const Samples& samples, const PointGrid& modelled, FilledCells& filled,
                                     const SelectOptions& options);

  /// Flat Gaussians of selected samples first, first + 1, ...: the local z axis lies along the normal. After select()
  /// with the same samples.
  void write(const Samples& samples, std::uint32_t first, const InitialOptions& options, const LightTerms& light,
             const InsertChannels& gaussians) const;

 private:
  /// Of each search cell, whether it has samples in a hole or lies beside one that has.
  [[nodiscard]] std::vector<bool> about_holes(const std::vector<CellSums>& sums) const;
  [[nodiscard]] ObjectFrames frames() const { return {objects_.data(), static_cast<std::uint32_t>(objects_.size())}; }

  device::StreamView stream_;
  float cell_size_m_;
  std::uint32_t binned_ = 0, cells_ = 0, beyond_ = 0;
  InsertReasons reasons_;
  std::vector<CellCount> report_, search_cells_;
  device::Buffer<ObjectFrame> objects_;
  device::Buffer<Viewpoint> viewpoints_;
  device::Buffer<CellKey> keys_, cell_keys_;
  device::Buffer<std::uint32_t> order_, cell_start_, selected_, counter_;
  device::Buffer<CellSums> sums_;
  device::Buffer<std::uint8_t> fill_, wanted_, lack_;
  device::Buffer<bool> seen_;
  device::Buffer<std::uint32_t> neighbours_;
};

/// Rotation, w x y z, that turns z into a unit normal the shortest way.
SPLATBUS_PORTABLE math::Vec4 rotation_to_normal(const math::Vec3& normal) {
  if (normal.z < -0.9999F) return {{0, 1, 0}, 0};  // half a turn about x: any axis across z would do
  const float w = 1 + normal.z, x = -normal.y, y = normal.x;
  const float scale = 1.0F / sqrtf(w * w + x * x + y * y);
  return {{w * scale, x * scale, y * scale}, 0};
}

SPLATBUS_PORTABLE float luminance(const math::Vec3& linear) {
  return dot(linear, math::Vec3{0.2126F, 0.7152F, 0.0722F});
}

/// How much of the sun reached a surface of that albedo and normal (world) when it was seen in that colour: (colour -
/// ambient part) / sun part, on luminance, in [0, 1]. 1 where the sun would not show anyway.
SPLATBUS_PORTABLE float guess_visibility(const math::Vec3& color, const math::Vec3& albedo, const math::Vec3& n,
                                         const LightTerms& light) {
  constexpr float kPi = 3.14159265358979323846F;
  const auto times = [](const math::Vec3& a, const math::Vec3& b) {
    return math::Vec3{a.x * b.x, a.y * b.y, a.z * b.z};
  };
  const float facing = math::larger(dot(n, light.sun_direction), 0.0F);
  const float sun = luminance(times(albedo, light.sun_irradiance)) * facing / kPi;
  if (sun < kMinSunPart) return 1;
  const math::Vec3* const a = light.ambient;
  const math::Vec3 sum = a[0] + a[1] * n.y + a[2] * n.z + a[3] * n.x + a[4] * (n.x * n.y) + a[5] * (n.y * n.z) +
                         a[6] * (2 * n.z * n.z - n.x * n.x - n.y * n.y) + a[7] * (n.x * n.z) +
                         a[8] * (n.x * n.x - n.y * n.y);
  const math::Vec3 reflected{math::larger(sum.x, 0), math::larger(sum.y, 0), math::larger(sum.z, 0)};
  return math::clamped((luminance(color) - luminance(times(albedo, reflected))) / sun, 0, 1);
}

}  // namespace splatbus::expander
