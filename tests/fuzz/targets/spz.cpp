// A .spz file from anywhere. The first byte chooses the axes.
#include "splats/spz.h"

#include "splat_stream.h"
#include "target.h"

namespace splats = splatbus::splats;

SPLATBUS_FUZZ_TARGET(spz, bytes) {
  splatbus::fuzz::read_splats(
      bytes, [](std::istream& stream, splats::Axes axes) { return splats::read_spz(stream, "fuzz", axes); });
}
