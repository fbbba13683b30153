#include "trainer/shown_shares.h"

#include <algorithm>

#include "gaussians/page_area.h"

namespace splatbus::trainer {

namespace {

constexpr float kKept = 0.9F;                // of what was seen before, with each view of the place
constexpr float kLeastShare = 1.0F / 65536;  // of one that was looked for: 0 says that none was
constexpr float kLeastArea_px = 4;           // smaller ones say nothing

}  // namespace

void ShownShares::see(const model::PageStore& store, std::span<const ViewLook> looks) {
  for (const ViewLook& look : looks) {
    const bool weighed = std::ranges::any_of(look.pages, [](const auto& page) { return page.weight_px >= 0; });
    if (weighed) see(store, look);
  }
}

void ShownShares::see(const model::PageStore& store, const ViewLook& look) {
  auto seen = look.pages.begin();
  for (const IndexRange& range : store.view().ranges) {
    const std::uint32_t number = range.first >> kPageShift;
    while (seen != look.pages.end() && seen->page < number) ++seen;
    model::PageEntry& entry = store.table().entry(number);
    if (number >= pages_.size()) pages_.resize(number + 1);
    Page& page = pages_[number];
    if (page.frame_id != entry.now.frame_id || page.morton_first != entry.now.morton_first) {
      page = {.frame_id = entry.now.frame_id, .morton_first = entry.now.morton_first};
      entry.shown_share = 0;
    }
    const auto sphere = bounding_sphere(entry.bounds, entry.now.frame_id, look.view->scene.objects);
    const auto area = sphere ? picture_area_px2(look.view->camera, *sphere) : std::nullopt;
    if (!area || *area < kLeastArea_px) continue;
    const bool shows = seen != look.pages.end() && seen->page == number;
    page.weight_px = kKept * page.weight_px + (shows ? seen->weight_px : 0.0F);
    page.area_px = kKept * page.area_px + *area;
    entry.shown_share = std::clamp(page.weight_px / page.area_px, kLeastShare, 1.0F);
  }
}

}  // namespace splatbus::trainer
