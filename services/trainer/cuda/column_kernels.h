#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

#include "trainer/insert_rows.h"
#include "trainer/model_planes.h"

// What a ModelStore does to columns, on the device. Device pointers; launches on `stream`, nothing waits. Counts are
// added to what `counter` holds.
namespace splatbus::trainer::cuda {

/// Light of an insert, world frame, and how its objects are turned: world from object, ascending ids.
struct InsertLight {
  float ambient_sh[27];  ///< [9][3]
  float sun_direction[3];
  float sun_irradiance[3];
};
struct ObjectRotation {
  std::uint32_t id;
  float w, x, y, z;
};

/// HostColumns::append; light and objects are for Radiance.
void launch_append(const ModelPlanes& planes, const InsertRows& rows, std::uint32_t first, std::uint32_t count,
                   std::uint64_t first_id, const InsertLight& light, const ObjectRotation* objects,
                   std::uint32_t object_count, cudaStream_t stream);

/// ModelPlanes::move_column of every pair: invisible until whole, ids last, one launch after the other.
void launch_copy_columns(const ModelPlanes& planes, const std::uint32_t* from, const std::uint32_t* to,
                         std::uint32_t count, float invisible_logit, cudaStream_t stream);
void launch_number_columns(const ModelPlanes& planes, std::uint32_t first, std::uint32_t count, std::uint64_t first_id,
                           cudaStream_t stream);

void launch_count_marks(const std::uint8_t* marks, std::uint32_t count, std::uint32_t* counter, cudaStream_t stream);

/// Lists the columns from `begin` to `end` whose mark is set, or is not set, ascending; *listed becomes their number.
void launch_list_columns(const std::uint8_t* marks, bool set, std::uint32_t begin, std::uint32_t end,
                         std::uint32_t* columns, std::uint32_t* listed, void* scratch, std::size_t scratch_bytes,
                         cudaStream_t stream);
[[nodiscard]] std::size_t list_columns_scratch_bytes(std::uint32_t count);

void launch_set_visibility(const ModelPlanes& planes, const float* values, std::uint32_t count, cudaStream_t stream);

/// broken[i] becomes 1 where a column is not finite, or its logit is below `invisible_logit`, 0 elsewhere.
void launch_find_broken(const ModelPlanes& planes, std::uint32_t count, float invisible_logit, std::uint8_t* broken,
                        cudaStream_t stream);

}  // namespace splatbus::trainer::cuda
