#pragma once

#include <glm/glm.hpp>

#include "trainer/model_columns.h"

namespace splatbus::trainer {

/// ModelColumns of planes in host memory.
class HostColumns final : public ModelColumns {
 public:
  void append(const ModelPlanes& planes, const InsertBatch& batch, std::size_t first, std::size_t count,
              std::uint64_t first_id) override;
  void duplicate(const ModelPlanes& planes, std::span<const std::uint32_t> columns, std::size_t first,
                 std::uint64_t first_id) override;
  ColumnMoves remove(const ModelPlanes& planes, std::size_t count, const std::uint8_t* dead) override;
  void set_visibility(const ModelPlanes& planes, const float* values, Device memory, std::size_t count) override;
  Inspection inspect(const ModelPlanes& planes, std::size_t count) override;

 private:
  std::vector<std::uint32_t> from_, to_;
};

}  // namespace splatbus::trainer
