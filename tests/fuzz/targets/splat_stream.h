#pragma once

#include <cmath>
#include <sstream>
#include <stdexcept>
#include <string>

#include "splats/file.h"
#include "target.h"

namespace splatbus::fuzz {

/// Reads a file of Gaussians, its bytes behind one that chooses the axes: it is refused by name, or can be drawn.
template <class Read>
void read_splats(Bytes bytes, const Read& read) {
  Input input(bytes);
  const auto axes = input.number() % 2 == 0 ? splats::Axes::OfFormat : splats::Axes::Turn;
  const Bytes content = input.rest();
  std::istringstream stream(std::string(content.begin(), content.end()));
  try {
    const splats::SplatFile file = read(stream, axes);
    require(file.gaussians.count() <= std::max<std::size_t>(64 * content.size(), 1U << 20U) / 19, "bounded memory");
    for (const float value : file.gaussians.parameters) require(std::isfinite(value), "finite parameters");
  } catch (const std::runtime_error& error) {
    require(std::string(error.what()).starts_with("fuzz: "), "refused by its name");
  }
}

}  // namespace splatbus::fuzz
