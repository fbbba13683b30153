#include "world/world.h"

#include <fcntl.h>
#include <fmt/format.h>

#include <cstring>

namespace splatbus::world {

namespace {

namespace fs = std::filesystem;

fs::path segment_path(const fs::path& folder, std::uint32_t number) {
  return folder / "segments" / fmt::format("{:06}.seg", number);
}

std::span<const std::byte> as_bytes(const auto& value) {
  return std::as_bytes(std::span(&value, 1));
}

}  // namespace

PageEntry World::entry_of(const RecordHeader& header, const PageHeader& page) {
  return {.mark = static_cast<PageMark>(header.mark),
          .state = static_cast<model::PageState>(page.state),
          .count = page.count,
          .step = page.step,
          .morton_last = page.morton_last,
          .bounds = {.low = {page.low_m[0], page.low_m[1], page.low_m[2]},
                     .high = {page.high_m[0], page.high_m[1], page.high_m[2]},
                     .max_scale_m = page.max_scale_m},
          .bytes = sizeof(header) + header.length};
}

WorldProgress World::progress() const {
  const std::lock_guard lock(mutex_);
  return progress_;
}

std::map<PageKey, PageEntry> World::pages() const {
  const std::lock_guard lock(mutex_);
  return pages_;
}

std::optional<PageEntry> World::find(const PageKey& key) const {
  const std::lock_guard lock(mutex_);
  const auto found = pages_.find(key);
  return found == pages_.end() ? std::nullopt : std::optional(found->second);
}

std::uint64_t World::bytes() const {
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = 0;
  for (const auto& [number, segment] : segments_) sum += segment.size;
  return sum;
}

std::uint64_t World::live_bytes() const {
  const std::lock_guard lock(mutex_);
  std::uint64_t sum = 0;
  for (const auto& [number, segment] : segments_) sum += segment.live_bytes;
  return sum;
}

std::size_t World::segments() const {
  const std::lock_guard lock(mutex_);
  return segments_.size();
}

std::vector<Damage> World::damage() const {
  const std::lock_guard lock(mutex_);
  return damage_;
}

std::vector<PageKey> World::lost() const {
  const std::lock_guard lock(mutex_);
  return lost_;
}

std::optional<Page> World::read(const PageKey& key) {
  std::shared_ptr<const File> file;
  PageEntry entry;
  {
    const std::lock_guard lock(mutex_);
    const auto found = pages_.find(key);
    if (found == pages_.end()) return {};
    entry = found->second;
    file = segments_.at(entry.segment).file;
  }
  std::string what;
  try {
    std::vector<std::byte> record(entry.bytes);
    if (!file->read(entry.offset, record)) throw WorldError("it ends too early");
    RecordHeader header;
    std::memcpy(&header, record.data(), sizeof(header));
    const auto payload = std::span<const std::byte>(record).subspan(sizeof(header));
    if (header.crc != header_crc(header) || header.key != key || header.length != payload.size() ||
        header.payload_crc != crc32_of(payload.data(), payload.size())) {
      throw WorldError("its checksum is wrong");
    }
    Page page = decode_page(payload, layout(), key, "page");
    page.mark = entry.mark;
    return page;
  } catch (const WorldError& error) {
    what = error.what();
  }
  const std::lock_guard lock(mutex_);
  damage_.push_back({file->path().string(), entry.offset, what});
  const auto found = pages_.find(key);
  // Compaction may have moved it while it was read.
  if (found != pages_.end() && found->second.segment == entry.segment && found->second.offset == entry.offset) {
    drop_live(key);
    lost_.push_back(key);
  }
  return {};
}

void World::drop_live(const PageKey& key) {
  const auto found = pages_.find(key);
  if (found == pages_.end()) return;
  segments_.at(found->second.segment).live_bytes -= found->second.bytes;
  pages_.erase(found);
}

void World::apply() {
  for (const Pending& change : pending_) {
    switch (change.kind) {
      case RecordKind::Page:
        drop_live(change.key);
        if (change.whole) {
          pages_[change.key] = change.entry;
          segments_.at(change.entry.segment).live_bytes += change.entry.bytes;
        } else {
          lost_.push_back(change.key);
        }
        break;
      case RecordKind::Removal:
        drop_live(change.key);
        break;
      case RecordKind::Mark: {
        const auto found = pages_.find(change.key);
        if (found != pages_.end()) found->second.mark = change.entry.mark;
        break;
      }
      case RecordKind::Commit:
        break;
    }
  }
  pending_.clear();
}

World::Segment& World::segment_for(std::size_t bytes) {
  if (!segments_.empty()) {
    Segment& last = segments_.rbegin()->second;
    if (segments_.rbegin()->first == highest_number_ && !last.sealed && last.size + bytes <= segment_bytes_)
      return last;
  }
  const std::uint32_t number = highest_number_ + 1;
  if (number == 0) throw WorldError(fmt::format("{}: its segments have used up all numbers", folder_.string()));
  SegmentHeader header{.number = number, .world_id = manifest_.world_id};
  header.crc = header_crc(header);
  auto file = std::make_shared<const File>(segment_path(folder_, number), O_RDWR | O_CREAT | O_TRUNC);
  file->write(0, as_bytes(header));
  const std::lock_guard lock(mutex_);
  highest_number_ = number;
  return segments_[number] = {.file = std::move(file), .size = sizeof(header)};
}

void World::append(RecordKind kind, const PageKey& key, PageMark mark, std::span<const std::byte> payload) {
  if (!lock_) throw WorldError(fmt::format("{}: opened to be read", folder_.string()));
  if (payload.size() > kMaxPayloadBytes) throw WorldError("a record is too large");
  RecordHeader header{.kind = kind,
                      .length = static_cast<std::uint32_t>(payload.size()),
                      .payload_crc = crc32_of(payload.data(), payload.size()),
                      .sequence = next_sequence_,
                      .key = key,
                      .mark = static_cast<std::uint32_t>(mark)};
  header.crc = header_crc(header);
  std::vector<std::byte> record(sizeof(header) + payload.size());
  std::memcpy(record.data(), &header, sizeof(header));
  if (!payload.empty()) std::memcpy(record.data() + sizeof(header), payload.data(), payload.size());
  Segment& segment = segment_for(record.size());
  segment.file->write(segment.size, record);
  Pending change{.kind = kind, .key = key, .entry = {.mark = mark}};
  const std::lock_guard lock(mutex_);
  if (kind == RecordKind::Page) {
    change.entry = entry_of(header, read_page_header(payload, layout(), "a page to write"));
    segment.pages.push_back(key);
    ++records_[key];
  }
  if (kind == RecordKind::Removal) segment.removals.push_back(key);
  if (kind == RecordKind::Mark) segment.marks.push_back(key);
  change.entry.segment = highest_number_;
  change.entry.offset = segment.size;
  pending_.push_back(change);
  segment.size += record.size();
  ++next_sequence_;
}

void World::put(const Page& page, std::span<const std::byte> payload) {
  const std::lock_guard writes(writing_);
  append(RecordKind::Page, page.key, page.mark, payload);
}

void World::remove(const PageKey& key) {
  const std::lock_guard writes(writing_);
  append(RecordKind::Removal, key, PageMark::Resident, {});
}

void World::mark(const PageKey& key, PageMark mark) {
  const std::lock_guard writes(writing_);
  append(RecordKind::Mark, key, mark, {});
}

void World::commit(const WorldProgress& progress, bool durable) {
  const std::lock_guard writes(writing_);
  commit_locked(progress, durable);
}

void World::commit_locked(const WorldProgress& progress, bool durable) {
  append(RecordKind::Commit, {}, PageMark::Resident, as_bytes(progress));
  if (durable) {
    // What went before into segments that are full by now, too; one that did not exist at the last commit needs its
    // name.
    for (auto segment = segments_.lower_bound(committed_segment_); segment != segments_.end(); ++segment) {
      sync_(*segment->second.file);
    }
    if (highest_number_ != committed_segment_) sync_folder(folder_ / "segments");
  }
  const std::lock_guard lock(mutex_);
  progress_ = progress;
  committed_segment_ = highest_number_;
  committed_bytes_ = segments_.at(highest_number_).size;
  apply();
}

void World::abandon() {
  const std::lock_guard writes(writing_);
  abandon_locked();
}

void World::abandon_locked() {
  const std::lock_guard lock(mutex_);
  for (const Pending& change : pending_) {
    Segment& segment = segments_.at(change.entry.segment);
    if (change.kind == RecordKind::Page) {
      segment.pages.pop_back();
      if (--records_[change.key] == 0) records_.erase(change.key);
    }
    if (change.kind == RecordKind::Removal) segment.removals.pop_back();
    if (change.kind == RecordKind::Mark) segment.marks.pop_back();
  }
  pending_.clear();
  while (!segments_.empty() && segments_.rbegin()->first > committed_segment_) {
    remove_file(segments_.rbegin()->second.file->path());
    segments_.erase(std::prev(segments_.end()));
  }
  const auto last = segments_.find(committed_segment_);
  if (last == segments_.end()) return;
  last->second.file->truncate(committed_bytes_);
  last->second.size = committed_bytes_;
}

}  // namespace splatbus::world
