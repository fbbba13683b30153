#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <span>

#include "gaussians/model.h"

namespace splatbus::trainer {

/// Most recent batches that the model remembers, as model/published carries them.
inline constexpr std::size_t kRememberedBatches = 4096;

/// The model's structure. Two copies lie in the slab and `SlabHeader::current` says which one counts, so that a trainer
/// killed at any instant leaves either the old structure or the new one.
struct Structure {
  std::uint64_t count = 0;
  std::uint64_t generation = 0;          ///< grows with every change of structure, across slabs and restarts
  std::uint64_t removal_generation = 0;  ///< of the last change that moved columns
  std::uint64_t next_gaussian_id = 1;
  std::uint64_t frozen = 0;
  std::uint64_t insert_epoch = 0;
  std::uint64_t batch_count = 0;
  std::array<std::uint64_t, kRememberedBatches> batches{};  ///< in order of insertion
};

/// What lies at the start of the model's slab slot.
struct SlabHeader {
  static constexpr std::uint64_t kMagic = 0x6c65646f6d627073;  // "spbmodel"
  static constexpr std::uint32_t kVersion = 1;

  std::uint64_t magic;
  std::uint32_t version;
  std::uint32_t appearance;
  std::uint32_t sh_degree;
  std::uint32_t channels;
  std::uint64_t capacity;
  std::atomic<std::uint32_t> current;  ///< index into `structure`

  // Progress, in place.
  std::uint64_t step;
  std::uint64_t views;
  double optimizer_s;

  std::array<Structure, 2> structure;
};

/// Byte offsets of the planes in the slot, for a capacity that is a multiple of 16 (planes begin on cache lines).
struct SlabLayout {
  std::size_t parameters = 0, average = 0, normal = 0, surface_point = 0, visibility = 0;
  std::size_t object_id = 0, flags = 0, cell = 0, gaussian_id = 0;
  std::size_t bytes = 0;

  SlabLayout(const ParameterLayout& layout, std::size_t capacity);
};

[[nodiscard]] std::size_t rounded_capacity(std::size_t capacity);

/// The planes of a slot, writable.
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
  ModelPlanes(const ParameterLayout& layout, std::size_t capacity, std::byte* slot);

  [[nodiscard]] GaussiansView view(std::size_t count) const;

  /// Copies column `from` over column `to`, its id last: until then the column under `to` is invisible, so that a copy
  /// cut short leaves nothing that shows.
  void move_column(std::size_t from, std::size_t to) const;

  /// Copies the first `count` columns of `other`, whose layout is the same.
  void copy_from(const ModelPlanes& other, std::size_t count) const;
};

}  // namespace splatbus::trainer
