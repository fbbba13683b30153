// A .ply file from anywhere. The first byte chooses the axes.
#include "splats/ply.h"

#include "splat_stream.h"
#include "target.h"

namespace splats = splatbus::splats;

SPLATBUS_FUZZ_TARGET(ply, bytes) {
  splatbus::fuzz::read_splats(
      bytes, [](std::istream& stream, splats::Axes axes) { return splats::read_ply(stream, "fuzz", axes); });
}
