#pragma once

#include <cstddef>

namespace splatbus::model {

/// The only slot of a slab of pages, and of the page table's.
inline constexpr std::size_t kSlot = 0;

}  // namespace splatbus::model
