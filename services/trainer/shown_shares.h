#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "model/page_store.h"
#include "trainer/gradient_step.h"

namespace splatbus::trainer {

/// Says in the page table how much of its place each page makes up in the pictures that are trained with
/// (PageEntry::shown_share): streamers send last what stands behind something. One thread.
class ShownShares {
 public:
  /// Takes in what steps saw, and once a second of optimizer time says what has come of it.
  void see(const model::PageStore& store, std::span<const ViewLook> looks);

 private:
  struct Page {
    std::uint32_t frame_id = 0;
    std::uint64_t morton_first = 0;
    bool known = false;
    float most = 0;  ///< of all looks since the last time
  };
  /// Where a look was from: its view would keep the pictures.
  struct Eye {
    Camera camera;
    ObjectTransforms objects;
  };
  Page& at(model::PageEntry& entry, std::uint32_t page);
  void say(const model::PageStore& store);
  [[nodiscard]] bool was_looked_for(const model::PageEntry& entry) const;

  std::vector<Page> pages_;
  std::vector<Eye> eyes_;  ///< some of those since the last time
  std::size_t looks_ = 0;
  double next_s_ = 0;
};

}  // namespace splatbus::trainer
