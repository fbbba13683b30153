#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

#include "bus/slab.h"
#include "gaussians/model.h"
#include "trainer/model_planes.h"

namespace splatbus::trainer {

/// Most recent batches that the model remembers, as model/published carries them.
inline constexpr std::size_t kRememberedBatches = 4096;

/// Opacity logit of a column that is being written, and what is taken for one that was left so.
inline constexpr float kInvisibleLogit = -20.0F;
inline constexpr float kLeftInvisibleLogit = -15.0F;

/// The model's structure. Two copies lie in the header and `SlabHeader::current` says which one counts, so that a
/// trainer killed at any instant leaves either the old structure or the new one.
struct Structure {
  std::uint64_t planes_slab = 0;  ///< id of the slab with the planes
  std::uint64_t capacity = 0;     ///< columns of every plane in it
  std::uint64_t count = 0;
  std::uint64_t generation = 0;          ///< grows with every change of structure, across slabs and restarts
  std::uint64_t removal_generation = 0;  ///< of the last change that moved columns
  std::uint64_t next_gaussian_id = 1;
  std::uint64_t insert_epoch = 0;
  std::uint64_t batch_count = 0;
  std::array<std::uint64_t, kRememberedBatches> batches{};  ///< in order of insertion
};

/// What lies in the model's header slab, in host memory.
struct SlabHeader {
  static constexpr std::uint64_t kMagic = 0x6c65646f6d627073;  // "spbmodel"
  static constexpr std::uint32_t kVersion = 3;

  std::uint64_t magic;
  std::uint32_t version;
  std::uint32_t appearance;
  std::uint32_t sh_degree;
  std::uint32_t channels;
  std::atomic<std::uint32_t> current;  ///< index into `structure`

  // Progress, in place.
  std::uint64_t step;
  std::uint64_t views;
  double optimizer_s;

  std::array<Structure, 2> structure;
};

/// Byte offsets of the planes in their slab's slot, for a capacity that is a multiple of 16 (planes begin on cache
/// lines).
struct SlabLayout {
  std::size_t parameters = 0, average = 0, normal = 0, surface_point = 0, visibility = 0;
  std::size_t object_id = 0, flags = 0, cell = 0, gaussian_id = 0;
  std::size_t bytes = 0;

  SlabLayout(const ParameterLayout& layout, std::size_t capacity);
};

[[nodiscard]] std::size_t rounded_capacity(std::size_t capacity);

/// Copies the first `count` columns between planes of one layout in any two kinds of memory, and waits for it.
void copy_columns(const ModelPlanes& to, Device to_memory, const ModelPlanes& from, Device from_memory,
                  std::size_t count);

}  // namespace splatbus::trainer
