#include "trainer/shown_shares.h"

#include <algorithm>
#include <utility>

#include "gaussians/page_area.h"

namespace splatbus::trainer {

namespace {

constexpr double kPeriod_s = 1;
constexpr float kKept = 0.8F;                // of what was seen before, with each time that the place is in a picture
constexpr float kLeastShare = 1.0F / 65536;  // of one that was looked for: 0 says that none was
constexpr float kLeastArea_px = 64;          // a look blends some pixels: what is smaller counts as being this large
constexpr std::size_t kEyes = 16;

}  // namespace

void ShownShares::see(const model::PageStore& store, std::span<const ViewLook> looks) {
  for (const ViewLook& look : looks) {
    if (look.pages.empty()) continue;
    Eye eye{look.view->camera, look.view->scene.objects};
    for (const raster::PageLook& seen : look.pages) {
      model::PageEntry& entry = store.table().entry(seen.page);
      if (!is_present(entry.now.state)) continue;
      const auto sphere = bounding_sphere(entry.bounds, entry.now.frame_id, eye.objects);
      const auto area_px2 = sphere ? picture_area_px2(eye.camera, *sphere) : std::nullopt;
      if (!area_px2) continue;
      Page& page = at(entry, seen.page);
      page.most = std::max(page.most, seen.weight_px / std::max(*area_px2, kLeastArea_px));
    }
    if (eyes_.size() < kEyes) {
      eyes_.push_back(std::move(eye));
    } else {
      eyes_[looks_ % kEyes] = std::move(eye);
    }
    ++looks_;
  }
  if (store.optimizer_s() >= next_s_ && !eyes_.empty()) say(store);
}

ShownShares::Page& ShownShares::at(model::PageEntry& entry, std::uint32_t page) {
  if (page >= pages_.size()) pages_.resize(page + 1);
  Page& of = pages_[page];
  const model::PageStructure& now = entry.now;
  if (of.known && of.frame_id == now.frame_id && of.morton_first == now.morton_first) return of;
  // Another page has its block. What an adopted table says of those that are there holds.
  if (of.known) entry.shown_share = 0;
  of = {.frame_id = now.frame_id, .morton_first = now.morton_first, .known = true};
  return of;
}

bool ShownShares::was_looked_for(const model::PageEntry& entry) const {
  return std::ranges::any_of(eyes_, [&](const Eye& eye) {
    const auto sphere = bounding_sphere(entry.bounds, entry.now.frame_id, eye.objects);
    const auto area_px2 = sphere ? picture_area_px2(eye.camera, *sphere) : std::nullopt;
    return area_px2 && *area_px2 >= kLeastArea_px;
  });
}

void ShownShares::say(const model::PageStore& store) {
  for (const IndexRange& range : store.view().ranges) {
    const std::uint32_t number = range.first >> kPageShift;
    model::PageEntry& entry = store.table().entry(number);
    const float most = std::exchange(at(entry, number).most, 0.0F);
    if (most == 0 && !was_looked_for(entry)) continue;
    entry.shown_share = std::clamp(std::max(kKept * entry.shown_share, most), kLeastShare, 1.0F);
  }
  eyes_.clear();
  next_s_ = store.optimizer_s() + kPeriod_s;
}

}  // namespace splatbus::trainer
