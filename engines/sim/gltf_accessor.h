#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

// NOLINTNEXTLINE(cppcoreguidelines-macro-usage): the library's own switches
#define TINYGLTF_NO_STB_IMAGE_WRITE
#include <tiny_gltf.h>

namespace splatbus::sim {

/// Reads an accessor as floats, `components` a row (normalised integers become [0, 1] or [-1, 1]). Throws
/// std::runtime_error that names the accessor when it is not of that shape, reaches out of its buffer, is sparse or
/// holds a value that is not finite.
[[nodiscard]] std::vector<float> read_floats(const tinygltf::Model& model, int accessor, int components);

/// Reads an accessor of unsigned scalars; every one must be below `limit`.
[[nodiscard]] std::vector<std::uint32_t> read_indices(const tinygltf::Model& model, int accessor, std::size_t limit);

}  // namespace splatbus::sim
