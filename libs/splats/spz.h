#pragma once

#include <istream>
#include <ostream>
#include <string>

#include "splats/axes.h"
#include "splats/baked_model.h"
#include "splats/file.h"

namespace splatbus::splats {

/// Niantic's format (github.com/nianticlabs/spz), version 4 or 3: means in 24 bits, scales, opacities and colours in 8,
/// rotations in 32, SH of degree 1 in 5 bits and of higher ones in 4. Positions have 12 fractional bits, or as many as
/// the outermost mean leaves. Throws and fails as write() does.
void write_spz(std::ostream& stream, const BakedModel& model, const WriteOptions& options);

/// Versions 2 to 4; of SH of degree 4 the first three degrees. Bounds every size by the stream's before it allocates: a
/// file that unpacks to over 1 MiB and to more than 64 times its size is refused. Throws std::runtime_error that says
/// `name`, where, and what was wrong.
[[nodiscard]] SplatFile read_spz(std::istream& stream, const std::string& name, Axes axes);

/// By a file's first byte.
[[nodiscard]] bool is_spz(int first_byte);

}  // namespace splatbus::splats
