// How a World takes out of its folder what is no longer so.

#include <algorithm>
#include <cstring>
#include <set>

#include "world/world.h"

namespace splatbus::world {

namespace {

/// Of a segment: what counts is rewritten where it is less.
constexpr double kShare = 0.5, kCrowdedShare = 0.9;

}  // namespace

bool World::compact(bool last_too) {
  const std::lock_guard writes(writing_);
  if (!pending_.empty()) return false;
  // The emptiest; not the one that is being written.
  auto chosen = segments_.end();
  double least = is_crowded() ? kCrowdedShare : kShare;
  std::map<PageKey, PageEntry> live;  // of it
  {
    const std::lock_guard lock(mutex_);
    for (auto segment = segments_.begin(); segment != segments_.end(); ++segment) {
      if (segment->first == highest_number_ && !last_too) continue;
      const auto size = static_cast<double>(std::max<std::size_t>(segment->second.size, 1));
      const double share = static_cast<double>(segment->second.live_bytes) / size;
      if (share >= least) continue;
      least = share;
      chosen = segment;
    }
    if (chosen == segments_.end()) return false;
    chosen->second.sealed = true;
    for (const PageKey& key : chosen->second.pages) {
      const auto found = pages_.find(key);
      if (found != pages_.end() && found->second.segment == chosen->first) live.insert(*found);
    }
  }
  try {
    carry_over(chosen->first, chosen->second, live);
    commit_locked(progress_, true);
  } catch (...) {
    abandon_locked();
    throw;
  }
  // Only now: until the commit these are what counts.
  remove_file(chosen->second.file->path());
  for (const PageKey& key : chosen->second.pages) {
    if (--records_[key] == 0) records_.erase(key);
  }
  {
    const std::lock_guard lock(mutex_);
    segments_.erase(chosen);
  }
  sync_folder(folder_ / "segments");
  return true;
}

void World::carry_over(std::uint32_t number, const Segment& old, const std::map<PageKey, PageEntry>& live) {
  const std::shared_ptr<const File> file = old.file;
  std::map<PageKey, std::size_t> here;  // records of each page
  for (const PageKey& key : old.pages) ++here[key];
  std::vector<PageKey> broken;
  for (const auto& [key, entry] : live) {
    std::vector<std::byte> record(entry.bytes);
    RecordHeader header;
    const bool whole = file->read(entry.offset, record);
    std::memcpy(&header, record.data(), sizeof(header));
    const auto payload = std::span<const std::byte>(record).subspan(sizeof(header));
    if (!whole || header.payload_crc != crc32_of(payload.data(), payload.size())) {
      broken.push_back(key);
      continue;
    }
    append(RecordKind::Page, key, entry.mark, payload);
  }
  std::set gone(old.removals.begin(), old.removals.end());
  gone.insert(old.pages.begin(), old.pages.end());
  std::map<PageKey, PageMark> marked;
  {
    const std::lock_guard lock(mutex_);
    for (const PageKey& key : broken) {
      if (!pages_.contains(key)) continue;  // somebody has read it meanwhile
      damage_.push_back({file->path().string(), live.at(key).offset, "its checksum is wrong"});
      drop_live(key);
      lost_.push_back(key);
    }
    std::erase_if(gone, [&](const PageKey& key) { return pages_.contains(key); });
    for (const PageKey& key : old.marks) {
      const auto elsewhere = pages_.find(key);
      if (elsewhere != pages_.end() && elsewhere->second.segment != number) marked[key] = elsewhere->second.mark;
    }
  }
  // What says that a page is no more stays as long as there is a record of it that would come back: a removal, or a
  // page that cannot be read.
  for (const PageKey& key : gone) {
    const auto records = records_.find(key);
    const auto in_here = here.find(key);
    const std::size_t elsewhere =
        (records == records_.end() ? 0 : records->second) - (in_here == here.end() ? 0 : in_here->second);
    if (elsewhere > 0) append(RecordKind::Removal, key, PageMark::Resident, {});
  }
  for (const auto& [key, mark] : marked) append(RecordKind::Mark, key, mark, {});
}

}  // namespace splatbus::world
