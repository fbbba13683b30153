#pragma once

#include <istream>
#include <ostream>
#include <string>

#include "splats/axes.h"
#include "splats/baked_model.h"
#include "splats/file.h"

namespace splatbus::splats {

/// The binary layout of 3DGS (Kerbl et al. 2023): x y z nx ny nz f_dc f_rest opacity scale rot, with comments that say
/// how it was trained and where up is. Whether all of it was written, the stream says.
void write_ply(std::ostream& stream, const BakedModel& model, const WriteOptions& options);

/// Any order and type of the properties; those that it does not know are skipped. `stream` can be sought in. Layout:
/// Radiance, the degree that the count of f_rest gives. Bounds every size by the stream's before it allocates. Throws
/// std::runtime_error that says `name`, the line or byte, and what was wrong.
[[nodiscard]] SplatFile read_ply(std::istream& stream, const std::string& name, Axes axes);

}  // namespace splatbus::splats
