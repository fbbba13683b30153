#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

#include "expander/cell_packing.h"
#include "expander/insert_planes.h"

// The mapper's work on the device. Everything is enqueued on `stream`, with no synchronisation and no allocation. All
// pointers are device pointers. The arithmetic is the host's, operation by operation (these files are compiled without
// fused multiply-add), so that both backends choose the same samples.
namespace splatbus::expander::cuda {

/// Quaternion w x y z: p_a = rotate(q, p_b) + t.
struct DeviceRigid {
  float w, x, y, z;
  float3 translation;
};

struct DeviceCamera {
  DeviceRigid camera_from_world;
  float fx, fy, cx, cy;
  bool orthographic;
};

struct DeviceObject {
  std::uint32_t id;
  DeviceRigid object_from_world;
};

/// `camera` of a sample that is garbage.
inline constexpr std::uint32_t kUnsound = 0xFFFFFFFF;

/// n samples: as they arrive (aligned to 4 bytes, values may be anything), or as they are kept.
template <class Vector, class Float, class Integer>
struct SampleArrays {
  Vector *position, *normal, *albedo, *color;
  Float *spacing_m, *cosine;
  Integer *object_id, *camera;
};
using IncomingSamples = SampleArrays<const float3, const float, const std::uint32_t>;
using Samples = SampleArrays<float3, float, std::uint32_t>;

struct RoundView {
  std::uint32_t count;
  Samples samples;
  const float* depth_m;  ///< [cameras][height][width]
  std::uint32_t height, width;
  const DeviceCamera* cameras;
  std::uint32_t camera_count;
  const DeviceObject* objects;  ///< by id
  std::uint32_t object_count;
};

struct SoundLimits {
  float largest_spacing_m, unit_tolerance;
};

/// Copies samples to `round`, normalised and clamped; garbage gets camera kUnsound and is counted in `dropped`.
void launch_take(const IncomingSamples& incoming, const RoundView& round, const SoundLimits& limits,
                 std::uint32_t* dropped, cudaStream_t stream);

/// Entries sorted by cell. The cells' arrays have room for as many cells as there are entries.
struct CellTableView {
  std::uint64_t* key;      ///< [n] sorted; kNoCell comes last
  std::uint32_t* order;    ///< [n] which entry is here; entries of a cell keep their order
  std::uint32_t* cell_of;  ///< [n] index of the entry's cell, plus 1; of no meaning for kNoCell
  std::uint64_t* id;       ///< [cells], ascending
  std::uint32_t* start;    ///< [cells + 1], of their entries
  std::uint32_t* cells;    ///< how many there are
};

/// Sorts n > 0 keys. `scratch` has cell_table_scratch_bytes(n); `entries` [n] is overwritten.
void launch_cell_table(const std::uint64_t* keys, std::uint32_t n, std::uint32_t* entries, const CellTableView& table,
                       void* scratch, std::size_t scratch_bytes, cudaStream_t stream);
[[nodiscard]] std::size_t cell_table_scratch_bytes(std::uint32_t n);

struct ModelledPoint {
  float3 position, normal;  ///< in the frame of the point's cell
};

/// What is modelled: points in the order of `cells`.
struct ModelledView {
  const ModelledPoint* points;
  CellTableView cells;
};

struct SurveyOptions {
  float3 viewer;
  float candidate_radius_m, cell_size_m, min_cosine, depth_tolerance;
};

/// Where the samples of a round lie: world, or the object's frame.
struct Placement {
  std::uint64_t* key;  ///< kNoCell: no candidate, or not seen
  float3 *position, *normal;
};

/// Which samples are seen by their cameras and near the viewer, and their cells. Counts the others in `unseen` when
/// their cameras do not see them.
void launch_survey(const RoundView& round, const SurveyOptions& options, const Placement& placement,
                   std::uint32_t* unseen, cudaStream_t stream);

struct ChooseOptions {
  float cell_size_m, new_distance, top_up_distance, top_up_fraction, same_surface_cosine;
  std::uint32_t min_samples, room;
};

struct ChoiceView {
  float* apart;             ///< [cells] distance to what is modelled, of the spacing; negative: not seen
  std::uint32_t* modelled;  ///< [cells] points
  std::uint32_t* fresh;     ///< [cells] samples that nothing covers
  std::uint32_t* inserted;  ///< [cells] of them, those that were chosen
  std::uint8_t* uncovered;  ///< [n] in the order of the cells
  std::uint8_t* taken;      ///< [n] in the order of the round
  std::uint32_t* cell_of;   ///< [n] in the order of the round: index of the cell
  std::uint32_t* chosen;    ///< [n] samples, ascending
  std::uint32_t* count;     ///< how many would be chosen if there were room
};

/// Grid::choose for a round of n > 0 placed samples, whose table is `cells`.
void launch_choose(const RoundView& round, const Placement& placement, const CellTableView& cells,
                   const ModelledView& modelled, const ChooseOptions& options, const ChoiceView& choice, void* scratch,
                   std::size_t scratch_bytes, cudaStream_t stream);
[[nodiscard]] std::size_t choose_scratch_bytes(std::uint32_t n);

struct InitialValues {
  float scale, log_flatness, opacity_logit, least_spacing_m, least_sun_part;
  float3 ambient[9];  ///< coefficients of 1, y, z, x, xy, yz, 2zz - xx - yy, xz, xx - yy: what white reflects
  float3 sun_direction, sun_irradiance;
};

/// Batches of `batch_size` Gaussians, the last with the rest of `count`, each `batch_stride` bytes behind the one
/// before.
struct BatchSpan {
  std::byte* data;
  std::uint32_t count, batch_size;
  std::size_t batch_stride;
};

void launch_gaussians(const RoundView& round, const Placement& placement, const std::uint32_t* chosen,
                      const InitialValues& values, const BatchSpan& batches, cudaStream_t stream);

/// The points of a batch, written to points and keys.
void launch_points_of_batch(const InsertPlanes& planes, std::uint32_t count, ModelledPoint* points, std::uint64_t* keys,
                            cudaStream_t stream);

/// Planes of somebody's live model, [3][stride]; aligned, values may be anything.
struct ModelPlanes {
  const float *position, *normal;
  const std::uint32_t* object_id;
  const std::uint64_t* cell;
  std::size_t stride;
};

/// The points of a model; a point that no cell holds gets kNoCell.
void launch_points_of_model(const ModelPlanes& planes, std::uint32_t count, float cell_size_m, ModelledPoint* points,
                            std::uint64_t* keys, cudaStream_t stream);

/// points[i] = from[order[i]].
void launch_gather(const ModelledPoint* from, const std::uint32_t* order, std::uint32_t count, ModelledPoint* points,
                   cudaStream_t stream);

/// Sets *found to 1 when a point of the batch is modelled exactly there.
void launch_find_exact(const InsertPlanes& planes, std::uint32_t count, const ModelledView& modelled,
                       std::uint32_t* found, cudaStream_t stream);

}  // namespace splatbus::expander::cuda
