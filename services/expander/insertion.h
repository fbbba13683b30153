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

/// Where somebody's model keeps what is needed of it: GaussiansView's layout. Values may be anything.
struct ModelPoints {
  const float *surface_point, *normal;
  const std::uint32_t* object_id;  ///< null: that of the range
  std::size_t stride;
  std::uint32_t page_shift;
  std::size_t page_stride;
  std::span<const IndexRange> ranges;  ///< in host memory: which indices are Gaussians
};

struct ModelledPoint {
  math::Vec3 position, normal;  ///< in the frame of the point's cell
};

struct CellCount {
  CellKey key;
  std::uint32_t count = 0;
};

/// The points that are modelled, in the order of their cells. Not thread-safe.
class PointGrid {
 public:
  PointGrid(device::StreamView stream, float cell_size_m);

  void clear() { count_ = 0; }
  void add(std::span<const InsertChannels> batches);
  /// The model's points and no others; those that no cell holds are left out.
  void assign(const ModelPoints& model);

  /// Whether exactly the position of any of the Gaussians is modelled in its frame.
  [[nodiscard]] bool holds_any(const InsertChannels& gaussians) const;
  /// Cells with points, ascending.
  [[nodiscard]] std::vector<CellCount> cells() const;

  [[nodiscard]] std::uint32_t size() const { return count_; }
  [[nodiscard]] const CellKey* keys() const { return keys_.data(); }
  [[nodiscard]] const ModelledPoint* points() const { return points_.data(); }
  [[nodiscard]] float cell_size_m() const { return cell_size_m_; }

 private:
  device::StreamView stream_;
  float cell_size_m_;
  std::uint32_t count_ = 0;
  device::Buffer<CellKey> keys_, new_keys_, merged_keys_;
  device::Buffer<ModelledPoint> points_, new_points_, merged_points_;
};

/// A moving object at the time of the round.
struct ObjectFrame {
  std::uint32_t id = 0;
  math::Similarity object_from_world;
};

inline constexpr float kSameSurfaceCosine = 0.5F;  ///< between normals of points that can cover one another

struct SelectOptions {
  float candidate_radius_m = 12;  ///< about the viewer
  std::uint32_t min_samples = 4;  ///< a cell counts as seen with this many, or with fewer beside a cell that has them
  float new_distance = 0.5F;  ///< of a sample's spacing: how near to modelled neighbours a new cell's samples may come
  float top_up_distance =
      0.75F;  ///< the same in cells that are modelled; a full square grid leaves nothing beyond 0.71
  float top_up_fraction = 0.02F;    ///< a modelled cell is topped up when this share of what it holds is new
  math::Vec3 viewer{};              ///< world
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

/// Finds the samples that the model lacks and makes Gaussians of them. Keeps its memory from round to round. Not
/// thread-safe.
class SampleSelector {
 public:
  explicit SampleSelector(device::StreamView stream);

  /// Selects the samples of cells that are near the viewer, seen, and either not modelled yet or modelled clearly less
  /// than they are seen now. Samples of an object of `objects` (ascending by id, none of id 0) live in the object's
  /// frame, all others stand still and live in the world's. Returns how many are selected.
  [[nodiscard]] std::uint32_t select(const Samples& samples, std::span<const ObjectFrame> objects,
                                     const PointGrid& modelled, const SelectOptions& options);

  /// Flat Gaussians of selected samples first, first + 1, ...: the local z axis lies along the normal. After select()
  /// with the same samples.
  void write(const Samples& samples, std::uint32_t first, const InitialOptions& options, const LightTerms& light,
             const InsertChannels& gaussians) const;

  /// Cells near the viewer that the last round has samples in, and how many; ascending.
  [[nodiscard]] std::vector<CellCount> cells() const;

 private:
  [[nodiscard]] std::uint32_t bin(const Samples& samples, std::span<const ObjectFrame> objects,
                                  const SelectOptions& options);

  device::StreamView stream_;
  float cell_size_m_ = 0;
  std::uint32_t binned_ = 0, cells_ = 0;
  device::Buffer<ObjectFrame> objects_;
  device::Buffer<CellKey> keys_, cell_keys_;
  device::Buffer<std::uint32_t> order_, cell_start_, new_samples_, selected_;
  device::Buffer<std::uint8_t> uncovered_, wanted_;
  device::Buffer<float> distance_;
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
