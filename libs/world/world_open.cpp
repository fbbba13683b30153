// How a World comes to know what a folder holds.

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/random.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>

#include "world/world.h"

namespace splatbus::world {

namespace {

namespace fs = std::filesystem;

/// Far beyond what anybody will ever number, and far from where counting on would overflow.
constexpr std::uint64_t kMaxId = std::uint64_t{1} << 62U;

/// Of "000012.seg".
std::optional<std::uint32_t> segment_number(const fs::path& path) {
  const std::string stem = path.stem().string();
  std::uint32_t number = 0;
  const auto [end, error] = std::from_chars(stem.data(), stem.data() + stem.size(), number);
  const bool all = error == std::errc() && end == stem.data() + stem.size() && stem.size() >= 6;
  return path.extension() == ".seg" && all && number > 0 ? std::optional(number) : std::nullopt;
}

std::optional<WorldProgress> progress_of(const ScannedRecord& record) {
  WorldProgress progress;
  if (!record.whole || record.payload.size() != sizeof(progress)) return {};
  std::memcpy(&progress, record.payload.data(), sizeof(progress));
  const bool sound = progress.next_gaussian_id >= 1 && progress.next_gaussian_id <= kMaxId && progress.step <= kMaxId &&
                     progress.views <= kMaxId && progress.optimizer_s >= 0 && std::isfinite(progress.optimizer_s);
  return sound ? std::optional(progress) : std::nullopt;
}

}  // namespace

World::World(const fs::path& folder, const WorldOptions& options)
    : folder_(folder),
      segment_bytes_(std::clamp(options.segment_bytes, std::size_t{4096}, kSegmentBytes)),
      max_bytes_(options.max_bytes),
      sync_(options.sync) {
  std::error_code error;
  fs::create_directories(folder_ / "segments", error);
  if (error) {
    const std::string what = fmt::format("{}: cannot be made: {}", folder_.string(), error.message());
    if (error == std::errc::no_space_on_device) throw DiskFull(what);
    throw WorldError(what);
  }
  lock_ = std::make_unique<File>(folder_ / "lock", O_RDWR | O_CREAT);
  if (::flock(lock_->descriptor(), LOCK_EX | LOCK_NB) != 0) {
    throw WorldError(fmt::format("{}: another process writes this world", folder_.string()));
  }
  if (fs::exists(manifest_path(folder_))) {
    manifest_ = read_manifest(folder_);
    if (manifest_.layout.channels() != options.layout.channels() ||
        manifest_.layout.appearance != options.layout.appearance) {
      throw WorldError(fmt::format("{}: its Gaussians are of another appearance", folder_.string()));
    }
    load();
    cut_tail();
  } else {
    if (!fs::is_empty(folder_ / "segments")) {
      throw WorldError(
          fmt::format("{}: it has segments, but no {}", folder_.string(), manifest_path(folder_).filename().string()));
    }
    manifest_ = {.layout = options.layout, .note = options.note};
    if (::getrandom(&manifest_.world_id, sizeof(manifest_.world_id), 0) != sizeof(manifest_.world_id)) {
      throw WorldError("cannot read random bytes");
    }
  }
  const bool is_new = manifest_.epoch == 0;
  manifest_.epoch += 1;
  try {
    write_manifest(folder_, manifest_);
  } catch (const WorldError&) {
    if (is_new) throw;  // else the one before stands: a disk that is full shows with the first commit
  }
}

World::World(const fs::path& folder) : folder_(folder), manifest_(read_manifest(folder)) {
  load();
  pending_.clear();
}

void World::load() {
  std::vector<std::pair<std::uint32_t, fs::path>> files;
  std::error_code error;
  for (fs::directory_iterator at(folder_ / "segments", error), end; !error && at != end; at.increment(error)) {
    if (const auto number = segment_number(at->path())) files.emplace_back(*number, at->path());
  }
  if (error) throw WorldError(fmt::format("{}: cannot be read: {}", folder_.string(), error.message()));
  std::sort(files.begin(), files.end());
  std::size_t sound_damage = 0;  // up to the last commit
  for (const auto& listed : files) {
    const std::uint32_t number = listed.first;
    const fs::path& path = listed.second;
    highest_number_ = std::max(highest_number_, number);
    std::shared_ptr<const File> file;
    try {
      file = std::make_shared<const File>(path, lock_ ? O_RDWR : O_RDONLY);
    } catch (const WorldError& unreadable) {
      // A writer may have compacted it since it was listed.
      if (lock_ || fs::exists(path)) damage_.push_back({path.string(), 0, unreadable.what()});
      continue;
    }
    const std::size_t size = file->size();
    // In place before its records are: they refer to it.
    Segment& segment = segments_[number] = {.file = file, .size = size};
    const std::size_t damage_before = damage_.size();
    const bool ours = scan_segment(
        *file, number, manifest_.world_id,
        [&](const ScannedRecord& record) {
          take_record(number, record);
          if (pending_.empty()) sound_damage = damage_.size();
        },
        damage_);
    segment.sealed = damage_.size() > damage_before;
    if (!ours) {
      // One that a crash has kept from becoming a segment is cut like any tail.
      if (segment.size < sizeof(SegmentHeader)) continue;
      segments_.erase(number);
      sound_damage = damage_.size();
    }
  }
  damage_.resize(sound_damage);
}

void World::take_record(std::uint32_t number, const ScannedRecord& record) {
  const RecordHeader& header = record.header;
  Segment& segment = segments_.at(number);
  if (header.sequence < next_sequence_ || header.sequence == std::numeric_limits<std::uint64_t>::max()) {
    damage_.push_back({segment.file->path().string(), record.offset,
                       fmt::format("record {} is not where it belongs", header.sequence)});
    return;
  }
  next_sequence_ = header.sequence + 1;
  Pending change{.kind = header.kind, .key = header.key, .entry = {}, .whole = record.whole};
  if (header.mark <= static_cast<std::uint32_t>(PageMark::Fetched)) {
    change.entry.mark = static_cast<PageMark>(header.mark);
  }
  switch (header.kind) {
    case RecordKind::Page:
      try {
        if (change.whole) change.entry = entry_of(header, read_page_header(record.payload, layout(), "page"));
      } catch (const WorldError& error) {
        damage_.push_back({segment.file->path().string(), record.offset, error.what()});
        change.whole = false;
      }
      segment.pages.push_back(header.key);
      ++records_[header.key];
      break;
    case RecordKind::Removal:
      segment.removals.push_back(header.key);
      break;
    case RecordKind::Mark:
      segment.marks.push_back(header.key);
      break;
    case RecordKind::Commit:
      if (const auto progress = progress_of(record)) {
        progress_ = *progress;
        committed_segment_ = number;
        committed_bytes_ = record.offset + sizeof(RecordHeader) + header.length;
        apply();
      }
      return;
  }
  change.entry.segment = number;
  change.entry.offset = record.offset;
  pending_.push_back(change);
}

void World::cut_tail() {
  const auto committed = segments_.find(committed_segment_);
  for (const auto& [number, segment] : segments_) {
    if (number > committed_segment_) cut_bytes_ += segment.size;
  }
  if (committed != segments_.end()) cut_bytes_ += committed->second.size - committed_bytes_;
  abandon_locked();
}

}  // namespace splatbus::world
