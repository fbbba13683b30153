#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "bus/slab.h"
#include "gaussians/light.h"
#include "trainer/insert_rows.h"

namespace splatbus::trainer {

/// Bytes of rows that lie in one piece, and where their planes are in it.
[[nodiscard]] std::size_t insert_rows_bytes(std::size_t stride);
[[nodiscard]] InsertRows insert_rows_at(const std::byte* memory, std::size_t stride);

/// New Gaussians in memory of our own, checked: everything finite, rotations and normals unit, albedo and visibility in
/// [0, 1]. Frames as in wire::ModelInsert.
struct InsertBatch {
  std::uint64_t epoch = 0;  ///< of the expander
  std::uint64_t batch = 0;  ///< unique within the epoch
  std::size_t count = 0;
  std::size_t dropped = 0;  ///< rows that were not finite or without a direction

  // In host memory: planes [channels][count].
  std::vector<float> mean, log_scale, rotation, opacity_logit, albedo, normal, visibility;
  std::vector<std::uint32_t> object_id;
  std::vector<std::uint64_t> cell;
  // Or in device memory, and the vectors are empty.
  std::shared_ptr<const std::byte> device_memory;
  InsertRows device_rows;

  ObjectTransforms objects;
  Light light;

  [[nodiscard]] InsertRows rows() const;
  /// Where they lie.
  [[nodiscard]] Device memory() const { return device_memory ? Device::Cuda : Device::Cpu; }
};

/// Keeps the rows in host memory that can be Gaussians, normalised and clamped; counts the others in `dropped`.
void keep_valid_rows(InsertBatch& batch);

}  // namespace splatbus::trainer
