#pragma once

#include <cstddef>
#include <cstdint>

#include "gaussians/layout.h"

namespace splatbus {

struct GaussiansView;

namespace trainer {

/// The planes of a model, writable, in either kind of memory: [channels][capacity]. Kernels take it as it is.
struct ModelPlanes {
  ParameterLayout layout;
  std::size_t capacity = 0;
  float* parameters = nullptr;
  float* average = nullptr;
  float* normal = nullptr;
  float* surface_point = nullptr;
  float* visibility = nullptr;
  std::uint32_t* object_id = nullptr;
  std::uint32_t* flags = nullptr;
  std::uint64_t* cell = nullptr;
  std::uint64_t* gaussian_id = nullptr;

  ModelPlanes() = default;
  /// Of a slab's slot, as SlabLayout says.
  ModelPlanes(const ParameterLayout& layout, std::size_t capacity, std::byte* slot);

  [[nodiscard]] GaussiansView view(std::size_t count) const;

  /// Copies column `from` over column `to`, its id last: until then the column under `to` is invisible, so that a copy
  /// cut short leaves nothing that shows. Host memory.
  void move_column(std::size_t from, std::size_t to) const;
};

}  // namespace trainer
}  // namespace splatbus
