#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "trainer/insert_batch.h"
#include "trainer/model_slab.h"

namespace splatbus::trainer {

/// What a removal moved: column from[k] now lies at to[k], both ascending, from[k] >= new_count > to[k]. Whoever keeps
/// something of his own for each column follows. The arrays lie in the model's memory until the next change.
struct ColumnMoves {
  std::size_t moved = 0;
  const std::uint32_t* from = nullptr;
  const std::uint32_t* to = nullptr;
  std::size_t new_count = 0;
};

/// keep[i] is the column that column i was. The moves' arrays lie in host memory.
[[nodiscard]] std::vector<std::uint32_t> kept_columns(const ColumnMoves& moves);

/// What a ModelStore does to columns of its planes, where they lie. Whatever else works on the planes has been waited
/// for before a call, and a call has finished its work when it returns. Not thread-safe. Throws std::runtime_error.
class ModelColumns {
 public:
  virtual ~ModelColumns() = default;

  /// Writes the first `count` rows of the batch, of either memory, to columns `first` and following, an average that is
  /// the value and ids from `first_id` on.
  virtual void append(const ModelPlanes& planes, const InsertBatch& batch, std::size_t first, std::size_t count,
                      std::uint64_t first_id) = 0;

  /// Copies columns to column `first` and following, with new ids.
  virtual void duplicate(const ModelPlanes& planes, std::span<const std::uint32_t> columns, std::size_t first,
                         std::uint64_t first_id) = 0;

  /// Moves the last columns that live into the holes; dead[i] != 0, in the planes' memory, is a hole. What is cut short
  /// leaves columns that do not show, and columns twice, of which the later one is whole.
  virtual ColumnMoves remove(const ModelPlanes& planes, std::size_t count, const std::uint8_t* dead) = 0;

  /// Values of either memory, clamped to [0, 1], to the first columns; what is not a number becomes 0.
  virtual void set_visibility(const ModelPlanes& planes, const float* values, Device memory, std::size_t count) = 0;

  /// What adoption wants to know, in host memory.
  struct Inspection {
    std::vector<std::uint64_t> gaussian_id;
    std::vector<std::uint8_t> broken;  ///< not finite, or left invisible
  };
  [[nodiscard]] virtual Inspection inspect(const ModelPlanes& planes, std::size_t count) = 0;
};

/// Throws bus::Error when this build or machine has no such memory.
[[nodiscard]] std::unique_ptr<ModelColumns> make_model_columns(Device memory);

}  // namespace splatbus::trainer
