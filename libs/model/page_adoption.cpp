// How a PageStore comes by its slabs: made, adopted from a process that was killed, or moved to.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "model/page_store.h"
#include "model/table_slot.h"

namespace splatbus::model {

namespace {

constexpr int kTimeout_ms = 10000;
constexpr auto kLife = bus::Context::SlabLife::ForSuccessor;
/// The table is in one of these; the other one is what it moves to. So it is with the pages.
constexpr std::array<const char*, 2> kTableRoles = {"page-table", "page-table-moved"};
constexpr std::array<const char*, 2> kPagesRoles = {"pages-", "pages-moved-"};

std::uint32_t page_capacity_for(std::size_t max_gaussians) {
  // A batch may split many pages at once, and the old ones stay until it is committed.
  constexpr std::size_t kSlack = 256;
  const std::size_t pages = 2 * ((max_gaussians + kPageLanes - 1) / kPageLanes) + kSlack;
  const std::size_t capacity = (pages + kArenaPages - 1) / kArenaPages * kArenaPages;
  if (max_gaussians == 0 || capacity > std::size_t{kMaxArenas} * kArenaPages || capacity * kPageLanes > kFromPage) {
    throw std::invalid_argument("max_gaussians is " + std::to_string(max_gaussians) + ", which no page table holds");
  }
  return static_cast<std::uint32_t>(capacity);
}

}  // namespace

PageStore::PageStore(std::shared_ptr<bus::Context> bus, const ParameterLayout& layout, PageStoreOptions options,
                     Device device)
    : bus_(std::move(bus)),
      layout_(layout),
      options_(std::move(options)),
      device_(device),
      stream_(device),
      device_ranges_(stream_),
      device_bounds_(stream_),
      items_(stream_),
      added_(stream_),
      moved_from_(stream_),
      moved_to_(stream_),
      scratch_(stream_) {
  if (!(options_.fill > 0 && options_.fill <= 1)) throw std::invalid_argument("a page's fill is not within 0 and 1");
  static_cast<void>(page_capacity_for(options_.max_gaussians));
  // Registering anything waits for the broker; asked before that, it would seem to hold no model.
  bus_->create_slab("start", 1, 4096);
  bus_->drop_slab("start");
  if (adopt()) return;
  if (options_.must_adopt) throw bus::Error("there is no model to go on with: it would begin " + origin_);
  begin_empty();
}

std::string PageStore::arena_role(std::uint32_t list, std::uint32_t arena) const {
  return kPagesRoles.at(list) + std::to_string(arena);
}

void PageStore::begin_empty() {
  const std::uint32_t capacity = page_capacity_for(options_.max_gaussians);
  range_ = std::make_unique<bus::SlabRange>(device_, capacity * page_bytes(layout_));
  memory_ = PageMemory(range_->data(), layout_);
  table_slab_ = bus_->create_slab(kTableRoles[0], 1, page_table_bytes(capacity), kTimeout_ms, Device::Cpu, kLife);
  table_slab_->begin_write(kSlot);
  table_ = PageTable::begin(table_slab_->slot_data(kSlot), layout_, capacity);
  table_slab_->end_write(kSlot);
  bus_->drop_slab(kTableRoles[1]);
  list_pages();
}

bool PageStore::adopt() {
  try {
    if (!adopt_table()) return false;
    const std::vector<std::uint32_t> open = table_.recover();
    const std::uint32_t capacity = page_capacity_for(options_.max_gaussians);
    if (capacity > table_.page_capacity()) grow_table(capacity);
    adopt_arenas();
    drop_others();
    list_pages();
    sweep(open);
  } catch (const bus::Error& error) {
    origin_ = "empty, for " + bus_->source() + "/" + kTableRoles[0] + " is of no use: " + error.what();
    return false;
  }
  origin_ = "adopted " + std::to_string(count()) + " Gaussians at step " + std::to_string(step());
  return true;
}

bool PageStore::adopt_table() {
  origin_ = "empty";
  for (const char* role : kTableRoles) {
    const std::string name = bus_->source() + "/" + role;
    auto slab = bus_->adopt_slab(name);
    if (!slab) continue;
    std::string why_not = "it is not one slot of host memory";
    const bool host = slab->descriptor().kind == Device::Cpu && slab->slots() == 1;
    const auto table =
        host ? PageTable::adopt(slab->slot_data(kSlot), slab->slot_bytes(), layout_, why_not) : std::nullopt;
    if (!table) {
      if (!table_slab_) origin_ = fmt::format("empty, for {} is of no use: {}", name, why_not);
      continue;
    }
    // Two of them are left when a move was cut short; the later one is whole, for its magic came last.
    if (table_slab_ && table->generation() <= table_.generation()) continue;
    table_slab_ = std::move(slab);
    table_ = *table;
  }
  return table_slab_ != nullptr;
}

void PageStore::grow_table(std::uint32_t page_capacity) {
  const bool first = table_slab_->name().ends_with(kTableRoles[1]);
  auto slab = bus_->create_slab(kTableRoles.at(first ? 0 : 1), 1, page_table_bytes(page_capacity), kTimeout_ms,
                                Device::Cpu, kLife);
  slab->begin_write(kSlot);
  std::byte* const memory = slab->slot_data(kSlot);
  const std::size_t old_bytes = page_table_bytes(table_.page_capacity());
  // All but the magic, with which it begins; the slab is zeroed, as entries of free pages are.
  std::memcpy(memory + sizeof(std::uint64_t), table_slab_->slot_data(kSlot) + sizeof(std::uint64_t),
              old_bytes - sizeof(std::uint64_t));
  auto& header = *reinterpret_cast<PageTableHeader*>(memory);
  header.page_capacity = page_capacity;
  header.generation.fetch_add(1);
  std::atomic_thread_fence(std::memory_order_release);
  header.magic = PageTableHeader::kMagic;
  slab->end_write(kSlot);
  std::string why_not;
  const auto table = PageTable::adopt(memory, slab->slot_bytes(), layout_, why_not);
  if (!table) throw bus::Error("the page table could not be moved: " + why_not);
  table_slab_ = std::move(slab);
  table_ = *table;
}

void PageStore::adopt_arenas() {
  const std::uint32_t list = table_.header().arena_list;
  const ArenaList& arenas = table_.header().arenas.at(list);
  std::vector<std::shared_ptr<bus::Slab>> slabs;
  for (std::uint32_t arena = 0; arena < arenas.count; ++arena) {
    const std::string name = bus_->source() + "/" + arena_role(list, arena);
    auto slab = bus_->adopt_slab(name);
    if (!slab || slab->id() != arenas.slab_id.at(arena)) throw bus::Error(name + " is gone");
    if (slab->slots() != 1 || slab->slot_bytes() != kArenaPages * page_bytes(layout_)) {
      throw bus::Error(name + " is of another size");
    }
    if (!slabs.empty() && slab->descriptor().kind != slabs.front()->descriptor().kind) {
      throw bus::Error(name + " is in another kind of memory than those before it");
    }
    slabs.push_back(std::move(slab));
  }
  const Device was = slabs.empty() ? device_ : slabs.front()->descriptor().kind;
  auto range = std::make_unique<bus::SlabRange>(was, table_.page_capacity() * page_bytes(layout_));
  for (auto& slab : slabs) range->append(std::move(slab));
  if (was == device_) {
    range_ = std::move(range);
    memory_ = PageMemory(range_->data(), layout_);
  } else {  // the process before had another backend
    move_arenas(was, *range);
  }
}

void PageStore::move_arenas(Device from, const bus::SlabRange& old_range) {
  const std::uint32_t list = 1 - table_.header().arena_list;
  ArenaList& arenas = table_.header().arenas.at(list);
  arenas.count = 0;
  range_ = std::make_unique<bus::SlabRange>(device_, table_.page_capacity() * page_bytes(layout_));
  memory_ = PageMemory(range_->data(), layout_);
  while (range_->slabs().size() < old_range.slabs().size()) add_arena(arenas, list);
  const std::size_t bytes = page_bytes(layout_);
  for (std::uint32_t page = 0; page < old_range.slabs().size() * kArenaPages; ++page) {
    if (!is_present(table_.entry(page).now.state)) continue;
    bus::copy_memory(range_->data() + page * bytes, device_, old_range.data() + page * bytes, from, bytes);
  }
  bus::finish_copies();
  table_.header().arena_list.store(list, std::memory_order_release);
}

void PageStore::add_arena(ArenaList& list, std::uint32_t list_number) {
  const std::uint32_t arena = list.count;
  auto slab = bus_->create_slab(arena_role(list_number, arena), 1, kArenaPages * page_bytes(layout_), kTimeout_ms,
                                device_, kLife);
  slab->begin_write(kSlot);  // whole from the start: it is the pages' generations that tell readers of changes
  slab->end_write(kSlot);
  list.slab_id.at(arena) = slab->id();
  range_->append(std::move(slab));
  list.count.store(arena + 1, std::memory_order_release);
  std::vector<std::uint32_t> pages;
  for (std::uint32_t page = (arena + 1) * kArenaPages; page-- > arena * kArenaPages;) pages.push_back(page);
  free_.insert(free_.begin(), pages.begin(), pages.end());
}

void PageStore::drop_others() const {
  const bool moved = table_slab_->name().ends_with(kTableRoles[1]);
  bus_->drop_slab(kTableRoles.at(moved ? 0 : 1));
  const std::uint32_t other = 1 - table_.header().arena_list;
  // One more than it lists, for one that was made and not yet listed.
  ArenaList& arenas = table_.header().arenas.at(other);
  if (arenas.count == 0) return;
  for (std::uint32_t arena = 0; arena <= std::min(arenas.count.load(), kMaxArenas - 1); ++arena) {
    bus_->drop_slab(arena_role(other, arena));
  }
  arenas.count = 0;
}

void PageStore::list_pages() {
  directory_.clear();
  free_.clear();
  const auto pages = static_cast<std::uint32_t>(range_->slabs().size()) * kArenaPages;
  for (std::uint32_t page = pages; page-- > 0;) {
    const PageStructure& now = table_.entry(page).now;
    if (now.state == PageState::Free) free_.push_back(page);
    if (is_present(now.state)) {
      directory_.push_back({now.frame_id, page, now.count, now.morton_first, now.id_first});
    }
  }
  sort_directory();
  refresh_ranges();
}

void PageStore::sort_directory() {
  std::sort(directory_.begin(), directory_.end(), [](const Page& a, const Page& b) {
    return std::tie(a.frame_id, a.morton, a.id) < std::tie(b.frame_id, b.morton, b.id);
  });
}

void PageStore::sweep(const std::vector<std::uint32_t>& open) {
  // A byte a lane comes to the host, and the ids of what was open: once a start.
  const std::size_t lanes = view().count;
  Buffer<std::uint8_t> marks(stream_, lanes);
  marks.clear();
  std::vector<LaneRange> pages;
  for (const IndexRange& range : ranges_) pages.push_back({range.first, range.count});
  mark_broken(stream_, memory_, pages, marks.data());
  std::vector<std::uint8_t> dead = marks.to_host();
  std::vector<std::uint64_t> ids(kPageLanes);
  for (const std::uint32_t page : open) {
    const std::uint32_t first = page * kPageLanes, count = table_.entry(page).now.count;
    device::copy(stream_, ids.data(), memory_.wide(memory_.gaussian_id, first), count * sizeof(std::uint64_t));
    stream_.wait();
    // A removal that was cut short leaves a Gaussian in two lanes; the later one is whole.
    std::vector<std::uint32_t> by_id(count);
    for (std::uint32_t lane = 0; lane < count; ++lane) by_id[lane] = lane;
    std::sort(by_id.begin(), by_id.end(),
              [&](std::uint32_t a, std::uint32_t b) { return std::tie(ids[a], a) < std::tie(ids[b], b); });
    for (std::uint32_t k = 0; k + 1 < count; ++k) {
      if (ids[by_id[k]] == ids[by_id[k + 1]]) dead[first + by_id[k]] = 1;
    }
  }
  marks.assign(dead);
  remove(marks.data(), open);
  refresh_bounds();
}

}  // namespace splatbus::model
