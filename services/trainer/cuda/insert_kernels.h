#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

#include "trainer/insert_rows.h"

// model/insert's rows on the device: the checks of keep_valid_rows. Device pointers; launches on `stream`, nothing
// waits.
namespace splatbus::trainer::cuda {

/// Lists the rows that can be Gaussians, in order, in keep[rows], and their number in *kept. `scratch` has
/// valid_rows_scratch_bytes(rows).
void launch_find_valid_rows(const InsertRows& from, std::uint32_t rows, std::uint8_t* valid, std::uint32_t* keep,
                            std::uint32_t* kept, void* scratch, std::size_t scratch_bytes, cudaStream_t stream);
[[nodiscard]] std::size_t valid_rows_scratch_bytes(std::uint32_t rows);

/// Writes row keep[i], normalised and clamped, to row i of `to`, for i below *kept.
void launch_gather_rows(const InsertRows& from, std::uint32_t rows, const std::uint32_t* keep,
                        const std::uint32_t* kept, const InsertRows& to, cudaStream_t stream);

}  // namespace splatbus::trainer::cuda
