#include "expander/handover.h"

#include <fmt/format.h>

#include <cmath>
#include <cstddef>

#include "bus/error.h"
#include "wire/model_generated.h"

namespace splatbus::expander {

namespace {

bool is_cell(const CellKey& key) {
  return key.level < kLevels && key.code < std::uint64_t{1} << 3U * (kCellBits - key.level);
}

}  // namespace

std::vector<std::uint8_t> write_handover(float cell_size_m, const CellTable& cells, const FilledCells& filled) {
  std::vector<wire::FilledCell> filled_cells;
  filled_cells.reserve(filled.size());
  for (const auto& [key, spacing_m] : filled.all()) {
    filled_cells.emplace_back(key.code, key.object_id, key.level, spacing_m);
  }
  std::vector<wire::SampledCell> sampled_cells;
  for (const CellCount& cell : cells.sampled()) {
    sampled_cells.emplace_back(cell.key.code, cell.key.object_id, cell.count);
  }
  flatbuffers::FlatBufferBuilder builder(64 + filled_cells.size() * sizeof(wire::FilledCell) +
                                         sampled_cells.size() * sizeof(wire::SampledCell));
  const auto filled_at = builder.CreateVectorOfStructs(filled_cells);
  const auto sampled_at = builder.CreateVectorOfStructs(sampled_cells);
  builder.Finish(wire::CreateExpanderHandover(builder, cell_size_m, filled_at, sampled_at));
  return {builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize()};
}

void read_handover(std::span<const std::uint8_t> bytes, float cell_size_m, CellTable& cells, FilledCells& filled) {
  flatbuffers::Verifier verifier(bytes.data(), bytes.size());
  if (!verifier.VerifyBuffer<wire::ExpanderHandover>(nullptr)) throw bus::Error("it does not verify");
  const auto& root = *flatbuffers::GetRoot<wire::ExpanderHandover>(bytes.data());
  if (root.cell_size_m() != cell_size_m) {
    throw bus::Error(fmt::format("its cells have {} m, and those here {} m", root.cell_size_m(), cell_size_m));
  }
  std::vector<CellCount> sampled;
  sampled.reserve(root.sampled()->size());
  for (const wire::SampledCell* cell : *root.sampled()) {
    const CellKey key{.object_id = cell->object_id(), .level = kReportLevel, .code = cell->code()};
    if (!is_cell(key)) throw bus::Error(fmt::format("{:#x} is not a cell of level {}", key.code, key.level));
    sampled.push_back({.key = key, .count = cell->samples()});
  }
  for (const wire::FilledCell* cell : *root.filled()) {
    const CellKey key{.object_id = cell->object_id(), .level = cell->level(), .code = cell->code()};
    if (!is_cell(key)) throw bus::Error(fmt::format("{:#x} is not a cell of level {}", key.code, key.level));
    if (!std::isfinite(cell->spacing_m()) || cell->spacing_m() <= 0) {
      throw bus::Error(fmt::format("a cell was filled at {} m", cell->spacing_m()));
    }
  }
  cells.set_samples(sampled);
  for (const wire::FilledCell* cell : *root.filled()) {
    const CellKey key{.object_id = cell->object_id(), .level = cell->level(), .code = cell->code()};
    if (!filled.restore(key, cell->spacing_m())) break;
  }
}

}  // namespace splatbus::expander
