#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "bus/slab_range.h"
#include "device/buffer.h"
#include "gaussians/light.h"
#include "gaussians/model.h"
#include "model/channels.h"
#include "model/insert_rows.h"
#include "model/page_content.h"
#include "model/page_kernels.h"
#include "model/page_table.h"

namespace splatbus::model {

/// Where a store may be told to stop, for tests of what follows a death: inside a change of structure.
enum class ChangePoint { Opened, Written, Cleared, Copied, Numbered, Proposed, Committed, FoldedOne, Folded };

struct PageStoreOptions {
  std::size_t max_gaussians = 0;
  std::size_t max_pages = 0;  ///< memory that is taken for pages, in whole arenas; 0: as max_gaussians says
  /// How full the pages are that a split leaves.
  float fill = 0.75F;
  /// Throws bus::Error where there is no model to go on with, rather than begin an empty one in its place.
  bool must_adopt = false;
  /// Called at each point of a change; empty outside of tests.
  std::function<void(ChangePoint)> at_point;
};

/// The live model: pages in slabs of either kind of memory, "<source>/pages-0" and so on, which come one by one as it
/// grows and are never moved, and a table of them in host memory, "<source>/page-table". Values change in place at any
/// time; structure changes only inside insert(), duplicate(), remove() and merge(), each of which is wholly done or not
/// at all for whoever adopts the slabs after a death (page_table.h). A store that is made where a killed process's
/// slabs still lie goes on with them, whichever kind of memory they are in.
///
/// Not thread-safe. Whoever works on pages on a stream of his own waits for it before he calls a function that is not
/// const, and finds its work done when it returns. Throws bus::Error and std::runtime_error; a change that throws may
/// leave the store unfit for use, but nothing that an adopter would mind.
class PageStore {
 public:
  /// Waits for the broker (bus::Error when it does not come). `max_gaussians` bounds growth, and with it all memory:
  /// 2 max_gaussians / kPageLanes pages and a few hundred. Throws std::invalid_argument for options out of range.
  PageStore(std::shared_ptr<bus::Context> bus, const ParameterLayout& layout, PageStoreOptions options,
            Device device = Device::Cpu);

  /// How the store began, in words: "empty", "adopted ...", or why what was found was of no use.
  [[nodiscard]] const std::string& origin() const { return origin_; }
  [[nodiscard]] Device device() const { return device_; }
  [[nodiscard]] const ParameterLayout& layout() const { return layout_; }
  [[nodiscard]] std::size_t count() const { return count_; }
  /// Gaussians that the model may grow by.
  [[nodiscard]] std::size_t room() const;
  /// Whether there is a page for one more that is put back.
  [[nodiscard]] bool has_page();
  [[nodiscard]] std::size_t page_count() const { return directory_.size(); }
  [[nodiscard]] const PageTable& table() const { return table_; }
  [[nodiscard]] std::uint64_t generation() const { return table_.generation(); }
  [[nodiscard]] bool holds(std::uint64_t epoch, std::uint64_t batch) const { return table_.holds({epoch, batch}); }
  [[nodiscard]] std::uint64_t next_gaussian_id() const { return table_.header().next_gaussian_id; }
  /// Bytes of channels that insertions and removals have written.
  [[nodiscard]] std::uint64_t written_bytes() const { return written_bytes_; }

  /// Of the arenas there are.
  [[nodiscard]] std::size_t arena_bytes() const { return range_->slabs().size() * kArenaPages * page_bytes(layout_); }
  /// Pages whose values rest, and the Gaussians in them.
  [[nodiscard]] std::size_t frozen_pages() const { return frozen_pages_; }
  [[nodiscard]] std::size_t frozen_count() const { return frozen_count_; }

  /// Pointers to the device's memory, ranges and bounds in the host's; good until the next change.
  [[nodiscard]] GaussiansView view() const;
  /// The same, with the averages over time for parameters.
  [[nodiscard]] GaussiansView average_view() const;
  [[nodiscard]] const PageMemory& memory() const { return memory_; }
  [[nodiscard]] float* parameters() const { return memory_.value(rows_of(Channel::Parameters, layout_).first, 0); }
  [[nodiscard]] float* average() const { return memory_.value(rows_of(Channel::Average, layout_).first, 0); }
  /// The view's ranges and bounds in the device's memory, [view().ranges.size()].
  [[nodiscard]] const IndexRange* device_ranges() const { return device_ranges_.data(); }
  [[nodiscard]] PageBounds* device_bounds() const { return device_bounds_.data(); }

  [[nodiscard]] std::uint64_t step() const { return table_.header().step; }
  [[nodiscard]] std::uint64_t views() const { return table_.header().views; }
  [[nodiscard]] double optimizer_s() const { return table_.header().optimizer_s; }
  void add_step(std::size_t views, double seconds);
  void add_time(double seconds) { table_.header().optimizer_s += seconds; }

  /// Adds `count` rows, which lie on the store's device, in a Radiance model lit as `scene` says, with ids in their
  /// order, and remembers the batch. Each goes to the page of its frame (its object id) and of its position's Morton
  /// key; a page that would overflow is replaced by new ones. None are added when the batch is held already, or belongs
  /// to an older epoch than the newest one seen; those beyond max_gaussians are left out.
  InsertResult insert(const InsertRows& rows, std::size_t count, const SceneState& scene, std::uint64_t epoch,
                      std::uint64_t batch);
  /// Adds a copy of each Gaussian, with new ids in their order, to the page of the original's key. `indices` lies on
  /// the device. Originals may have moved afterwards, as the result says.
  InsertResult duplicate(const std::uint32_t* indices, std::size_t count);
  /// Removes the Gaussians with a non-zero entry: `dead` is [view().count] on the device. The last of a page fill its
  /// holes; a page that is empty is free.
  RemoveResult remove(const std::uint8_t* dead);
  /// Puts neighbouring pages together that fill no more of one than a split leaves, so that what removals have emptied
  /// is free for insertions. Costs nothing but a look at the directory where there are none.
  Moves merge();

  /// Puts pages in as they were somewhere else, with their Gaussians' ids, keys and states, and sees to it that no new
  /// Gaussian gets an id below `next_gaussian_id`. Of what may lie (it comes from a disk) only Gaussians that are
  /// finite and have an id below that stay. Returns the page each lies in now, or kNotInserted: nothing is left of it,
  /// there is a page of that key, or there is no room.
  std::vector<std::uint32_t> restore(std::span<const PageContent> pages, std::uint64_t next_gaussian_id);
  /// The model goes on from there: what the steps so far came to. Of a store that has just begun.
  void set_progress(std::uint64_t step, std::uint64_t views, double optimizer_s);
  /// The pages are free, and their Gaussians gone from here.
  void take_out(std::span<const std::uint32_t> pages);
  /// Where pages are that have been taken out: what is inserted in there is left out, for it is modelled already.
  void set_spilled(std::vector<SpilledRange> ranges);

  /// The values of these active pages become their averages and rest: IndexRange::frozen of the view says so. A page
  /// that is not active is left as it is.
  void freeze(std::span<const std::uint32_t> pages);
  /// Frozen pages become active, as do those that anything is put into or removed from.
  void thaw(std::span<const std::uint32_t> pages);

  /// The pages whose structure is what it was at `generation`, and whose indices are below `count`.
  [[nodiscard]] std::vector<LaneRange> unchanged_since(std::uint64_t generation, std::size_t count) const;
  /// Takes over the sun's visibility of those pages, in place: `values` by index on the device, 255 sees all of it.
  void set_visibility(const std::uint8_t* values, std::span<const LaneRange> pages);
  /// Makes bounds what the parameters say now, on the host, on the device and in the table; with slack, so that they
  /// hold while no mean moves farther than `move_m` and no scale grows by more than `growth`. Frozen pages keep theirs.
  void refresh_bounds(float move_m = 0, float growth = 1);

  /// Publishes model/published with the pages as they are now.
  void publish(const bus::Publisher& publisher) const;

 private:
  struct Page {
    std::uint32_t frame_id = kWorldFrame;
    std::uint32_t page = kNoPage, count = 0;
    std::uint64_t morton = 0, id = 0;  ///< first key
  };
  static constexpr std::uint32_t kNoPage = 0xFFFFFFFFU;
  struct PageChange {
    std::uint32_t page = 0;
    PageStructure next;
    PageBounds bounds;
    LaneRange fresh;  ///< lanes that bounds are still to take in
  };
  struct Plan;

  // page_adoption.cpp
  bool adopt();
  void begin_empty();
  bool adopt_table();
  void adopt_arenas();
  void grow_table(std::uint32_t page_capacity);
  void move_arenas(Device from, const bus::SlabRange& old_range);
  void sweep(const std::vector<std::uint32_t>& open);
  void drop_others() const;
  [[nodiscard]] std::string arena_role(std::uint32_t list, std::uint32_t arena) const;
  void add_arena(ArenaList& list, std::uint32_t list_number);
  void list_pages();
  void sort_directory();

  // page_change.cpp
  void reserve_pages(std::size_t pages);
  /// `items` of `rows` that are new.
  Plan place(std::uint32_t items, std::uint32_t rows);
  void begin_frames(std::vector<Page>& pages) const;
  void plan_page(Plan& plan, const Page& page, std::uint32_t first_item, std::uint32_t items);
  void plan_split(Plan& plan, const Page& page, std::uint32_t first_item, std::uint32_t items, std::uint32_t new_pages);
  void copy_moved(std::size_t count);
  InsertResult finish_insert(Plan& plan, std::uint32_t count, const std::optional<BatchKey>& batch);
  RemoveResult remove(const std::uint8_t* dead, const std::vector<std::uint32_t>& also);
  void bound(std::vector<PageChange>& changes) const;
  void apply(const std::vector<PageChange>& changes, std::uint64_t next_gaussian_id,
             const std::optional<BatchKey>& batch);
  [[nodiscard]] std::uint32_t taken(std::size_t count);
  [[nodiscard]] std::uint32_t fill_target() const;
  void at(ChangePoint point) const {
    if (options_.at_point) options_.at_point(point);
  }

  void refresh_ranges();

  std::shared_ptr<bus::Context> bus_;
  ParameterLayout layout_;
  PageStoreOptions options_;
  Device device_;
  device::Stream stream_;
  std::string origin_;
  std::shared_ptr<bus::Slab> table_slab_;
  PageTable table_;
  std::unique_ptr<bus::SlabRange> range_;
  PageMemory memory_;
  bool said_full_ = false;

  std::vector<SpilledRange> spilled_;  ///< ascending

  // The table's pages with Gaussians by frame and first key, and its free ones, the lowest last.
  std::vector<Page> directory_;
  std::vector<std::uint32_t> free_;
  std::size_t count_ = 0, frozen_count_ = 0, frozen_pages_ = 0;
  std::uint64_t written_bytes_ = 0;

  std::vector<IndexRange> ranges_;
  std::vector<PageBounds> bounds_;
  Buffer<IndexRange> device_ranges_;
  Buffer<PageBounds> device_bounds_;
  Buffer<Item> items_;
  Buffer<std::uint32_t> added_, moved_from_, moved_to_;
  Buffer<float> scratch_;
};

}  // namespace splatbus::model
