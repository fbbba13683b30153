#pragma once

#include <ostream>

#include "splats/baked_model.h"
#include "splats/file.h"

namespace splatbus::splats {

/// Binary glTF 2.0 with KHR_gaussian_splatting as of its Release Candidate (2026): floats, one primitive of points,
/// with COLOR_0 for programs that show points alone. Throws and fails as write() does.
void write_glb(std::ostream& stream, const BakedModel& model, const WriteOptions& options);

}  // namespace splatbus::splats
