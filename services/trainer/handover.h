#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "gaussians/pages.h"
#include "raster/adam.h"

// What a trainer that leaves hands to the next one beside the model, in a slab of host memory, whichever device either
// computes on: Adam's moments and the Gaussians' ages. Progress, ids and batches are the page table's already.
namespace splatbus::trainer {

struct HandoverHeader {
  static constexpr std::uint64_t kMagic = 0x72766f646e616873;  // "shandovr"
  static constexpr std::uint32_t kVersion = 1;

  std::uint64_t magic = kMagic;
  std::uint32_t version = kVersion;
  std::uint32_t channels = 0;
  std::uint64_t step = 0;  ///< of the model that it belongs to
  std::uint32_t pages = 0, reserved = 0;
};

/// Of one page, followed by moment_floats() of its kind. The Gaussians' ids say whether the page is still the same.
struct HandoverPage {
  std::uint32_t page = 0, count = 0;
  raster::PageMoments kind = raster::PageMoments::None;
  std::uint32_t reserved = 0;
  std::uint64_t gaussian_id[kPageLanes] = {};
  std::uint64_t created_step[kPageLanes] = {};
};

[[nodiscard]] constexpr std::size_t handover_bytes(raster::PageMoments kind, std::size_t channels) {
  constexpr std::size_t kAlign = alignof(HandoverPage);
  const std::size_t bytes = sizeof(HandoverPage) + raster::moment_floats(kind, channels) * sizeof(float);
  return (bytes + kAlign - 1) / kAlign * kAlign;
}

/// What came of a handover.
struct Restored {
  std::size_t pages = 0, gaussians = 0;
  std::string refusal;  ///< why nothing of it was of use; empty: it was
};

}  // namespace splatbus::trainer
