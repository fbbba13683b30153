#include "model/page_table.h"

#include <algorithm>
#include <new>

#include "bus/subscriber.h"
#include "model/channels.h"

namespace splatbus::model {

PageTable PageTable::begin(std::byte* memory, const ParameterLayout& layout, std::uint32_t page_capacity) {
  PageTable table;
  table.header_ = new (memory) PageTableHeader{};
  table.entries_ = reinterpret_cast<PageEntry*>(table.header_ + 1);
  for (std::uint32_t page = 0; page < page_capacity; ++page) new (table.entries_ + page) PageEntry{};
  PageTableHeader& header = *table.header_;
  header.version = PageTableHeader::kVersion;
  header.appearance = static_cast<std::uint32_t>(layout.appearance);
  header.sh_degree = static_cast<std::uint32_t>(layout.sh_degree);
  header.channels = static_cast<std::uint32_t>(layout.channels());
  header.page_lanes = kPageLanes;
  header.page_words = page_words(layout);
  header.page_capacity = page_capacity;
  header.generation = 1;
  header.next_gaussian_id = 1;
  std::atomic_thread_fence(std::memory_order_release);
  header.magic = PageTableHeader::kMagic;
  return table;
}

std::optional<PageTable> PageTable::adopt(std::byte* memory, std::size_t bytes, const ParameterLayout& layout,
                                          std::string& why_not) {
  const auto refuse = [&](const char* why) {
    why_not = why;
    return std::nullopt;
  };
  if (bytes < sizeof(PageTableHeader)) return refuse("it is too small for a page table");
  auto& header = *reinterpret_cast<PageTableHeader*>(memory);
  if (header.magic != PageTableHeader::kMagic || header.version != PageTableHeader::kVersion) {
    return refuse("it does not hold a page table");
  }
  const bool other_degree = layout.appearance == Appearance::Radiance &&  // Transfer has no use for it
                            header.sh_degree != static_cast<std::uint32_t>(layout.sh_degree);
  if (header.appearance != static_cast<std::uint32_t>(layout.appearance) || other_degree ||
      header.channels != static_cast<std::uint32_t>(layout.channels())) {
    return refuse("its appearance is another one");
  }
  if (header.page_lanes != kPageLanes || header.page_words != page_words(layout)) {
    return refuse("its pages are of another size");
  }
  if (header.page_capacity > (bytes - sizeof(PageTableHeader)) / sizeof(PageEntry) ||
      header.page_capacity > kMaxArenas * kArenaPages) {
    return refuse("it claims more pages than it has room for");
  }
  PageTable table;
  table.header_ = &header;
  table.entries_ = reinterpret_cast<PageEntry*>(&header + 1);
  if (header.arena_list > 1 || header.arenas.at(header.arena_list).count > kMaxArenas) {
    return refuse("it names no arenas");
  }
  const std::uint32_t pages = header.arenas.at(header.arena_list).count * kArenaPages;
  for (std::uint32_t page = 0; page < header.page_capacity; ++page) {
    for (const PageStructure* structure : {&table.entries_[page].now, &table.entries_[page].next}) {
      if (structure->count > kPageLanes || structure->state > PageState::Spilled ||
          (structure->state != PageState::Free && page >= pages)) {
        return refuse("its entries contradict each other");
      }
    }
  }
  return table;
}

std::string why_not_adoptable(const bus::Message& published, const ParameterLayout& layout) {
  const auto table = published.tensor("page_table");
  if (!table || table->memory() != Device::Cpu) return "its page table cannot be read";
  std::string why_not;
  // adopt() only looks.
  auto* const memory = const_cast<std::byte*>(table->data());  // NOLINT(cppcoreguidelines-pro-type-const-cast)
  if (PageTable::adopt(memory, table->bytes(), layout, why_not)) return {};
  return why_not;
}

bool PageTable::holds(const BatchKey& batch) const {
  if (batch.epoch != header_->insert_epoch) return batch.epoch < header_->insert_epoch;
  const std::size_t held = std::min<std::uint64_t>(header_->batch_total, kRememberedBatches);
  const auto end = header_->batches.begin() + static_cast<std::ptrdiff_t>(held);
  return std::find(header_->batches.begin(), end, batch.batch) != end;
}

std::vector<std::uint64_t> PageTable::batches() const {
  const std::uint64_t total = header_->batch_total;
  std::vector<std::uint64_t> result;
  for (std::uint64_t i = total - std::min<std::uint64_t>(total, kRememberedBatches); i < total; ++i) {
    result.push_back(header_->batches.at(i % kRememberedBatches));
  }
  return result;
}

void PageTable::open(std::uint32_t page) const {
  PageEntry& entry = entries_[page];
  entry.generation.store(2 * generation() + 1, std::memory_order_relaxed);
  std::atomic_thread_fence(std::memory_order_release);
}

void PageTable::propose(std::uint32_t page, const PageStructure& next) const {
  open(page);
  entries_[page].next = next;
  entries_[page].change.store(header_->change.load(std::memory_order_relaxed) + 1, std::memory_order_release);
}

void PageTable::commit(std::uint64_t next_gaussian_id, const std::optional<BatchKey>& batch) const {
  const std::uint64_t change = header_->change.load(std::memory_order_relaxed) + 1;
  header_->next.change = 0;  // whatever a change that was never committed has left there
  std::atomic_signal_fence(std::memory_order_seq_cst);
  header_->next.next_gaussian_id = next_gaussian_id;
  header_->next.has_batch = batch ? 1 : 0;
  header_->next.epoch = batch ? batch->epoch : 0;
  header_->next.batch = batch ? batch->batch : 0;
  std::atomic_signal_fence(std::memory_order_seq_cst);
  header_->next.change = change;
  header_->change.store(change, std::memory_order_release);
}

void PageTable::fold_header() const {
  const PageTableHeader::Next& next = header_->next;
  if (next.change != header_->change.load(std::memory_order_relaxed) || next.change == 0) return;
  header_->next_gaussian_id = std::max(header_->next_gaussian_id, next.next_gaussian_id);
  if (next.has_batch == 0 || holds({next.epoch, next.batch})) return;
  // In an order that a death leaves such that the same again completes it.
  if (header_->insert_epoch != next.epoch) {
    header_->batch_total = 0;
    std::atomic_signal_fence(std::memory_order_seq_cst);
    header_->insert_epoch = next.epoch;
  }
  header_->batches.at(header_->batch_total % kRememberedBatches) = next.batch;
  std::atomic_signal_fence(std::memory_order_seq_cst);
  header_->batch_total += 1;
}

void PageTable::fold(std::uint32_t page, const PageBounds& bounds) const {
  PageEntry& entry = entries_[page];
  entry.now = entry.next;
  entry.bounds = bounds;
  entry.change.store(0, std::memory_order_release);
  entry.generation.store(2 * (generation() + 1), std::memory_order_release);
}

void PageTable::close() const {
  fold_header();
  header_->generation.fetch_add(1, std::memory_order_release);
}

std::vector<std::uint32_t> PageTable::recover() const {
  std::vector<std::uint32_t> open;
  const std::uint64_t committed = header_->change.load(std::memory_order_acquire);
  for (std::uint32_t page = 0; page < header_->page_capacity; ++page) {
    PageEntry& entry = entries_[page];
    const std::uint64_t change = entry.change.load(std::memory_order_acquire);
    if (change != 0 && change <= committed) entry.now = entry.next;
    entry.change.store(0, std::memory_order_release);
    if (entry.generation.load(std::memory_order_acquire) % 2 == 0) continue;
    // Stays open until the page has been looked through.
    if (is_present(entry.now.state)) {
      open.push_back(page);
    } else {
      entry.generation.store(2 * (generation() + 1), std::memory_order_release);
    }
  }
  fold_header();
  header_->generation.fetch_add(1, std::memory_order_release);
  return open;
}

}  // namespace splatbus::model
