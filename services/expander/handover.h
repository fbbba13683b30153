#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "expander/cell_table.h"
#include "expander/filled_cells.h"

// What an expander that leaves hands to the next one beside the model (wire::ExpanderHandover): what it knows of cells.
// What is modelled is read from the model.
namespace splatbus::expander {

[[nodiscard]] std::vector<std::uint8_t> write_handover(float cell_size_m, const CellTable& cells,
                                                       const FilledCells& filled);

/// `bytes` are aligned to 8. Throws bus::Error, naming what is wrong, with both as they were.
void read_handover(std::span<const std::uint8_t> bytes, float cell_size_m, CellTable& cells, FilledCells& filled);

}  // namespace splatbus::expander
