#pragma once

#include <cstddef>
#include <cstdint>

namespace splatbus::model {

/// What becomes Gaussians: planes [channels][stride] in either kind of memory, everything finite, rotations (w x y z)
/// and normals unit, albedo (linear) and visibility in [0, 1]; positions in metres in the frame of their object.
/// Kernels take it as it is.
struct InsertRows {
  std::size_t stride = 0;
  const float* mean = nullptr;           ///< [3]
  const float* log_scale = nullptr;      ///< [3]
  const float* rotation = nullptr;       ///< [4]
  const float* opacity_logit = nullptr;  ///< [1]
  const float* albedo = nullptr;         ///< [3]
  const float* normal = nullptr;         ///< [3]
  const float* visibility = nullptr;     ///< [1]
  const std::uint32_t* object_id = nullptr;
};

/// Light of an insert, world frame, and what it is to its objects: how they are turned, world from object, and whether
/// they shine with their albedo instead. Ascending ids.
struct InsertLight {
  float ambient_sh[27];  ///< [9][3]
  float sun_direction[3];
  float sun_irradiance[3];
};
struct ObjectRotation {
  std::uint32_t id;
  float w, x, y, z;
  bool emissive;
};

/// In place of an index: the Gaussian is not in the model, for no page was left for it.
inline constexpr std::uint32_t kNotInserted = 0xFFFFFFFFU;

/// Gaussian from[k] now lies at to[k]: whoever keeps something of his own for each index follows. No index is both
/// among `from` and among `to`, so that moves may be made in any order. The arrays lie in the store's memory until the
/// next change of structure.
struct Moves {
  std::size_t count = 0;
  const std::uint32_t* from = nullptr;
  const std::uint32_t* to = nullptr;
};

struct InsertResult {
  std::size_t count = 0;                 ///< rows that were taken in order, of which
  std::size_t left_out = 0;              ///< so many found no page, or are in one that is spilled
  const std::uint32_t* added = nullptr;  ///< [count] index of each row's Gaussian or kNotInserted; memory as Moves
  Moves moves;
};

struct RemoveResult {
  std::size_t removed = 0;
  Moves moves;
};

}  // namespace splatbus::model
