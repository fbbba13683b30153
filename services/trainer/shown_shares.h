#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "model/page_store.h"
#include "trainer/gradient_step.h"

namespace splatbus::trainer {

/// Says in the page table how much of its place each page makes up in the pictures that are trained with
/// (PageEntry::shown_share): streamers send last what stands behind something. Of all looks that weigh pages, newer
/// ones counting more. One thread.
class ShownShares {
 public:
  void see(const model::PageStore& store, std::span<const ViewLook> looks);

 private:
  struct Page {
    std::uint32_t frame_id = 0;
    std::uint64_t morton_first = 0;
    float weight_px = 0, area_px = 0;  ///< sums over views, of which each counts less than the next
  };
  void see(const model::PageStore& store, const ViewLook& look);

  std::vector<Page> pages_;
};

}  // namespace splatbus::trainer
