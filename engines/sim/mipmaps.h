#pragma once

#include <vector>

#include "sim/scene.h"

namespace splatbus::sim {

/// Whether its sides are powers of two.
[[nodiscard]] bool has_whole_mipmaps(const Image& image);

/// The levels below an image of sRGB, down to one texel: each texel is the mean, in linear light, of the 2 x 2 that it
/// covers (2 x 1 where one side is at its end), its alpha theirs. Of an image that has_whole_mipmaps(). On several
/// threads.
[[nodiscard]] std::vector<Image> mipmaps(const Image& image);

}  // namespace splatbus::sim
