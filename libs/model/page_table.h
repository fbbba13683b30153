#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "gaussians/layout.h"
#include "gaussians/pages.h"

namespace splatbus::bus {
class Message;
}

// What a model's header slab holds, in host memory that other processes read and that outlives its writer: the header,
// and behind it an entry a page. docs/decisions/0085-pages.md says how a change of structure commits by one store.
namespace splatbus::model {

inline constexpr std::uint32_t kArenaPages = 128;
/// As many as one message can name.
inline constexpr std::uint32_t kMaxArenas = 480;
/// Most recent batches that the model remembers, as model/published carries them.
inline constexpr std::size_t kRememberedBatches = 4096;

/// A frozen page is there as an active one is, but its values rest: whatever changes its structure makes it active.
enum class PageState : std::uint32_t { Free, Active, Frozen, Spilled };

/// Whether its block holds the page's Gaussians.
[[nodiscard]] constexpr bool is_present(PageState state) {
  return state == PageState::Active || state == PageState::Frozen;
}

/// Structure of a page. Its Gaussians' keys (Morton, id) are at least (morton_first, id_first) and below those of the
/// frame's next page; the first page of a frame begins at (0, 0).
struct PageStructure {
  PageState state = PageState::Free;
  std::uint32_t frame_id = kWorldFrame;
  std::uint32_t level = 0;
  std::uint32_t count = 0;  ///< Gaussians, in lanes [0, count)
  std::uint64_t morton_first = 0, id_first = 0;
};

struct PageEntry {
  /// Twice the table's generation at which the structure last changed; odd while it changes. A reader takes what it
  /// read of the page and its entry when this was even before and is the same after.
  std::atomic<std::uint64_t> generation;
  std::uint64_t version;  ///< of the values, where whoever changes them counts
  PageStructure now;
  std::atomic<std::uint64_t> change;  ///< that makes `next` of `now`; 0: none
  PageStructure next;
  PageBounds bounds;
  float loss, movement, contribution;
  std::uint64_t last_seen_step;
};

/// The slabs that the pages lie in, "<source>/pages-0" and so on, or those that they move to.
struct ArenaList {
  std::atomic<std::uint32_t> count;
  std::array<std::uint64_t, kMaxArenas> slab_id;
};

struct alignas(64) PageTableHeader {
  static constexpr std::uint64_t kMagic = 0x7365676170627073;  // "spbpages"
  static constexpr std::uint32_t kVersion = 2;

  std::uint64_t magic;
  std::uint32_t version;
  std::uint32_t appearance, sh_degree, channels;
  std::uint32_t page_lanes, page_words, page_capacity;
  std::atomic<std::uint32_t> arena_list;  ///< index into `arenas`
  std::array<ArenaList, 2> arenas;

  // Progress, in place.
  std::uint64_t step, views;
  double optimizer_s;

  std::atomic<std::uint64_t> change;      ///< the last that is committed
  std::atomic<std::uint64_t> generation;  ///< of the whole structure; grows with each change, across restarts
  std::uint64_t next_gaussian_id;
  std::uint64_t insert_epoch;
  std::uint64_t batch_total;  ///< of that epoch; the last kRememberedBatches are at batches[i % kRememberedBatches]
  std::array<std::uint64_t, kRememberedBatches> batches;

  /// What change number `change` makes of the fields above.
  struct Next {
    std::uint64_t change;
    std::uint64_t next_gaussian_id;
    std::uint64_t has_batch, epoch, batch;
  } next;
};

static_assert(std::atomic<std::uint64_t>::is_always_lock_free && std::atomic<std::uint32_t>::is_always_lock_free,
              "the table is shared between processes");

[[nodiscard]] constexpr std::size_t page_table_bytes(std::uint32_t page_capacity) {
  return sizeof(PageTableHeader) + std::size_t{page_capacity} * sizeof(PageEntry);
}
/// The entries behind a header.
[[nodiscard]] inline const PageEntry* page_entries(const PageTableHeader& header) {
  return reinterpret_cast<const PageEntry*>(&header + 1);
}

/// Why a store of this layout could not go on with the model that the message tells of; empty: it could.
[[nodiscard]] std::string why_not_adoptable(const bus::Message& published, const ParameterLayout& layout);

struct BatchKey {
  std::uint64_t epoch = 0, batch = 0;
};

/// The writer's side of a table in somebody else's memory. Not thread-safe.
class PageTable {
 public:
  PageTable() = default;
  /// A new one in zeroed memory of page_table_bytes(page_capacity).
  static PageTable begin(std::byte* memory, const ParameterLayout& layout, std::uint32_t page_capacity);
  /// One that is there already, of any writer's making; recover() before use. Nothing, and why not, when the memory
  /// holds no table for this layout.
  static std::optional<PageTable> adopt(std::byte* memory, std::size_t bytes, const ParameterLayout& layout,
                                        std::string& why_not);

  [[nodiscard]] PageTableHeader& header() const { return *header_; }
  [[nodiscard]] PageEntry& entry(std::uint32_t page) const { return entries_[page]; }
  [[nodiscard]] std::uint32_t page_capacity() const { return header_->page_capacity; }
  [[nodiscard]] std::uint64_t generation() const { return header_->generation.load(std::memory_order_relaxed); }
  [[nodiscard]] bool holds(const BatchKey& batch) const;
  [[nodiscard]] std::vector<std::uint64_t> batches() const;  ///< most recent last

  // A change: open() each page before anything that readers see of it is touched, propose() what each becomes,
  // commit(), fold() each page, close(). What was proposed and not committed is as if it had never been.
  void open(std::uint32_t page) const;
  void propose(std::uint32_t page, const PageStructure& next) const;
  void commit(std::uint64_t next_gaussian_id, const std::optional<BatchKey>& batch) const;
  /// bounds: of the page as it is now.
  void fold(std::uint32_t page, const PageBounds& bounds) const;
  void close() const;

  /// Brings an adopted table to the last commit. Returns the pages with Gaussians that were open: of those, Gaussians
  /// may lie in two lanes, or carry the id 0, which is nobody's.
  [[nodiscard]] std::vector<std::uint32_t> recover() const;

 private:
  void fold_header() const;

  PageTableHeader* header_ = nullptr;
  PageEntry* entries_ = nullptr;
};

}  // namespace splatbus::model
