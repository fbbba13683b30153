#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <stdexcept>
#include <string>

#include "sim/gltf_accessor.h"
#include "sim/gltf_scene.h"

namespace splatbus::sim {

/// What is left of a limit.
class Budget {
 public:
  Budget(std::uintmax_t limit, const char* what) : limit_(limit), left_(limit), what_(what) {}

  /// Throws when it is not there.
  void take(std::uintmax_t amount) {
    if (amount > left_) throw std::runtime_error(fmt::format("more than {} {} in all", limit_, what_));
    left_ -= amount;
  }

 private:
  std::uintmax_t limit_, left_;
  const char* what_;
};

/// Reads a glTF file, those that it names, and its images: four channels of eight bits each. Throws std::runtime_error.
[[nodiscard]] tinygltf::Model read_gltf_file(const std::string& path, const GltfLimits& limits);

}  // namespace splatbus::sim
