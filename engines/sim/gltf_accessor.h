#pragma once

#include <fmt/format.h>

#include <cstddef>
#include <cstdint>
#include <exception>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

// NOLINTNEXTLINE(cppcoreguidelines-macro-usage): the library's own switches
#define TINYGLTF_NO_STB_IMAGE_WRITE
#include <tiny_gltf.h>

namespace splatbus::sim {

/// The most rows of an accessor.
constexpr std::size_t kMostRows = 20'000'000;

/// items[index]; throws std::runtime_error "there is no <what> <index>".
template <class T>
[[nodiscard]] const T& item(const std::vector<T>& items, int index, const char* what) {
  if (index < 0 || static_cast<std::size_t>(index) >= items.size()) {
    throw std::runtime_error(fmt::format("there is no {} {}", what, index));
  }
  return items[static_cast<std::size_t>(index)];
}

/// Adds where it happened to what went wrong.
template <class Call>
decltype(auto) within(const std::string& where, Call&& call) {
  try {
    return std::forward<Call>(call)();
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("{}: {}", where, error.what()));
  }
}

/// Reads an accessor as floats, `components` a row (normalised integers become [0, 1] or [-1, 1]). Throws
/// std::runtime_error that names the accessor when it is not of that shape, reaches out of its buffer, is sparse or
/// holds a value that is not finite.
[[nodiscard]] std::vector<float> read_floats(const tinygltf::Model& model, int accessor, int components);

/// Reads an accessor of unsigned scalars; every one must be below `limit`.
[[nodiscard]] std::vector<std::uint32_t> read_indices(const tinygltf::Model& model, int accessor, std::size_t limit);

}  // namespace splatbus::sim
