#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "world/format.h"
#include "world/manifest.h"
#include "world/page_codec.h"
#include "world/segment.h"

namespace splatbus::world {

/// Of a page in the folder, without its Gaussians.
struct PageEntry {
  PageMark mark = PageMark::Resident;
  model::PageState state = model::PageState::Active;
  std::uint32_t count = 0;
  std::uint64_t step = 0, morton_last = 0;
  PageBounds bounds;
  std::uint32_t segment = 0;
  std::size_t offset = 0, bytes = 0;  ///< of the record's header; of the whole record
};

struct WorldOptions {
  ParameterLayout layout;
  std::string note;  ///< of a new world
  std::size_t segment_bytes = kSegmentBytes;
  std::size_t max_bytes = 0;  ///< from three quarters of it on, less is wasted for more writing; 0: none
  /// Brings a file to disk; other than File::sync() in tests.
  std::function<void(const File&)> sync = [](const File& file) { file.sync(); };
};

/// A folder of pages on disk: an append-only log in segments, of which compact() takes what is no longer so out again.
/// What is written takes effect with commit(), all of it or, after a crash, nothing. One process writes a folder at a
/// time, any number may read it. docs/world-folder.md has the format.
///
/// Every call is safe from any thread, but what is written between two commits should come from one. Whoever reads or
/// asks waits for no disk that somebody else writes to. Throws WorldError, and leaves what is committed as it was.
class World {
 public:
  /// To write: makes the folder where there is none, and cuts what a crash has left behind the last commit. WorldError
  /// when another process writes it, or it is of another layout.
  World(const std::filesystem::path& folder, const WorldOptions& options);
  /// To read, as it is now, also while another process writes it.
  explicit World(const std::filesystem::path& folder);

  [[nodiscard]] const std::filesystem::path& folder() const { return folder_; }
  [[nodiscard]] const Manifest& manifest() const { return manifest_; }
  [[nodiscard]] const ParameterLayout& layout() const { return manifest_.layout; }
  [[nodiscard]] WorldProgress progress() const;
  [[nodiscard]] std::map<PageKey, PageEntry> pages() const;
  [[nodiscard]] std::optional<PageEntry> find(const PageKey& key) const;
  [[nodiscard]] std::uint64_t bytes() const;       ///< on disk, of all segments
  [[nodiscard]] std::uint64_t live_bytes() const;  ///< of them, those that count
  /// Whether they are near max_bytes.
  [[nodiscard]] bool is_crowded() const { return max_bytes_ > 0 && bytes() > max_bytes_ / 4 * 3; }
  [[nodiscard]] std::size_t segments() const;
  /// What was found not to be as it was written, and the pages that are lost by it: they are left out.
  [[nodiscard]] std::vector<Damage> damage() const;
  [[nodiscard]] std::vector<PageKey> lost() const;
  /// Bytes behind the last commit that opening has cut.
  [[nodiscard]] std::uint64_t cut_bytes() const { return cut_bytes_; }

  /// Reads a page and checks it once more. Nothing when there is none of that key, or, from now on, when it is damaged.
  [[nodiscard]] std::optional<Page> read(const PageKey& key);

  /// `payload` by encode_page().
  void put(const Page& page, std::span<const std::byte> payload);
  void remove(const PageKey& key);
  void mark(const PageKey& key, PageMark mark);
  /// Makes all since the last commit so. `durable`: also after the machine loses its power, when it returns.
  void commit(const WorldProgress& progress, bool durable = true);
  /// Forgets what was written since the last commit.
  void abandon();

  /// Rewrites what still counts of one segment, where it is less than half of it (nine tenths, while bytes() is near
  /// max_bytes), and removes that. False when there is none. Not between put() and commit().
  /// `last_too`: also the segment that is being written, which then ends.
  bool compact(bool last_too = false);

 private:
  struct Segment {
    std::shared_ptr<const File> file;
    std::size_t size = 0, live_bytes = 0;
    /// With damage in it: what is legible might be another once something follows, so that nothing does.
    bool sealed = false;
    std::vector<PageKey> pages, removals, marks;  ///< of the records in it
  };
  struct Pending {
    RecordKind kind = RecordKind::Commit;
    PageKey key;
    PageEntry entry;
    bool whole = true;
  };

  void load();
  void take_record(std::uint32_t segment, const ScannedRecord& record);
  void cut_tail();
  void apply();
  void drop_live(const PageKey& key);
  [[nodiscard]] static PageEntry entry_of(const RecordHeader& header, const PageHeader& page);
  Segment& segment_for(std::size_t bytes);
  void append(RecordKind kind, const PageKey& key, PageMark mark, std::span<const std::byte> payload);
  void commit_locked(const WorldProgress& progress, bool durable);
  void abandon_locked();
  /// `live`: the pages that count of it.
  void carry_over(std::uint32_t number, const Segment& old, const std::map<PageKey, PageEntry>& live);

  std::filesystem::path folder_;
  Manifest manifest_;
  std::size_t segment_bytes_ = kSegmentBytes, max_bytes_ = 0;
  std::unique_ptr<File> lock_;  ///< of a writer

  std::function<void(const File&)> sync_;
  /// Whoever writes holds it, for as long as the disk takes. What says so below is his alone.
  std::mutex writing_;
  /// Of all else, which only changes while both are held, but for what read() finds damaged; never while a disk works.
  mutable std::mutex mutex_;
  std::map<std::uint32_t, Segment> segments_;
  std::map<PageKey, PageEntry> pages_;
  /// The writer's: of each page, in all segments, those that no longer count, too.
  std::map<PageKey, std::size_t> records_;
  WorldProgress progress_;
  std::vector<Damage> damage_;
  std::vector<PageKey> lost_;
  // The writer's.
  std::vector<Pending> pending_;
  std::uint64_t next_sequence_ = 1;
  std::uint32_t highest_number_ = 0;
  std::uint32_t committed_segment_ = 0;
  std::size_t committed_bytes_ = 0;  ///< of that segment
  std::uint64_t cut_bytes_ = 0;
};

}  // namespace splatbus::world
