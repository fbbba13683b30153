#include "model/published_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <utility>

#include "bus/error.h"
#include "bus/memory.h"
#include "model/channels.h"
#include "model/page_table.h"
#include "wire/model_generated.h"

namespace splatbus {

namespace {

using model::PageEntry;
using model::PageTableHeader;

[[noreturn]] void reject(const bus::Message& message, const std::string& what) {
  throw bus::Error(message.topic() + " from " + message.header().source()->str() + ": " + what);
}

ParameterLayout layout_of(const bus::Message& message, const wire::ModelPublished& published) {
  ParameterLayout layout;
  switch (published.appearance()) {
    case wire::Appearance::Transfer:
      layout.appearance = Appearance::Transfer;
      return layout;
    case wire::Appearance::Radiance:
      if (published.sh_degree() > 3) reject(message, fmt::format("SH degree {} is above 3", published.sh_degree()));
      layout.appearance = Appearance::Radiance;
      layout.sh_degree = published.sh_degree();
      return layout;
  }
  reject(message, fmt::format("unknown appearance {}", static_cast<int>(published.appearance())));
}

/// Nullopt when the tensor lies in a slab that is gone.
std::optional<bus::TensorView> find_tensor(const bus::Message& message, const std::string& name, bus::ElementType type,
                                           const std::vector<std::uint32_t>& shape) {
  auto view = message.tensor(name, type, shape);
  if (!view && !message.announces(name)) reject(message, fmt::format("tensor \"{}\" is missing", name));
  return view;
}

}  // namespace

std::optional<PublishedModel> PublishedModel::open(const bus::Message& message, Device device, Need need,
                                                   const PublishedModel* before) {
  const auto& published = message.root<wire::ModelPublished>();
  PublishedModel opened;
  opened.device_ = device;
  opened.need_ = need;
  opened.generation_ = published.generation();
  opened.step_ = published.step();
  opened.count_ = published.count();
  const ParameterLayout layout = layout_of(message, published);
  opened.live_.layout = layout;
  if (published.page_lanes() != kPageLanes || published.page_words() != model::page_words(layout)) {
    reject(message, fmt::format("pages of {} Gaussians in {} words; this build reads {} in {}", published.page_lanes(),
                                published.page_words(), kPageLanes, model::page_words(layout)));
  }
  if (published.page_capacity() == 0 || published.page_capacity() > model::kMaxArenas * model::kArenaPages ||
      published.arenas() > model::kMaxArenas) {
    reject(message, fmt::format("{} pages in {} arenas", published.page_capacity(), published.arenas()));
  }

  const auto table_bytes = static_cast<std::uint32_t>(model::page_table_bytes(published.page_capacity()));
  auto table = find_tensor(message, "page_table", bus::ElementType::U8, {table_bytes});
  if (!table) return std::nullopt;
  opened.tensors_.push_back(std::move(*table));
  for (std::uint32_t arena = 0; arena < published.arenas(); ++arena) {
    auto pages =
        find_tensor(message, fmt::format("pages-{}", arena), bus::ElementType::U32, {0, model::page_words(layout)});
    if (!pages) return std::nullopt;
    // Mapped behind one another, slabs are to be whole arenas, however many pages of the last are in use.
    const bool whole = pages->slab() == nullptr ||
                       pages->slab()->descriptor().slot_bytes >= model::kArenaPages * model::page_bytes(layout);
    if (pages->dim(0) == 0 || pages->dim(0) > model::kArenaPages || !whole) {
      reject(message, fmt::format("arena {} has {} pages", arena, pages->dim(0)));
    }
    opened.tensors_.push_back(std::move(*pages));
  }
  opened.take_table(message, opened.tensors_.front());
  if (!opened.read_pages(message, published.arenas())) return std::nullopt;

  const auto in_place = [&](const bus::TensorView& pages) {
    return pages.slab() != nullptr && pages.memory() == device;
  };
  if (std::all_of(opened.tensors_.begin() + 1, opened.tensors_.end(), in_place)) {
    opened.map_arenas(before);
    opened.make_views(opened.range_->data(), need);
    if (!opened.still_valid()) return std::nullopt;
    return opened;
  }
  const std::size_t pages = opened.ranges_.empty() ? 0 : (opened.ranges_.back().first >> kPageShift) + 1;
  opened.copies_ = bus::allocate_memory(device, pages * model::page_bytes(layout));
  opened.make_views(opened.copies_.get(), need);
  if (!opened.refresh()) return std::nullopt;
  return opened;
}

void PublishedModel::take_table(const bus::Message& message, const bus::TensorView& tensor) {
  if (tensor.memory() != Device::Cpu) reject(message, "its page table is not in host memory");
  const std::byte* memory = tensor.data();
  if (tensor.slab() == nullptr) {
    auto copy = bus::allocate_memory(Device::Cpu, tensor.bytes());
    std::memcpy(copy.get(), memory, tensor.bytes());
    memory = copy.get();
    table_copy_ = std::move(copy);
  }
  table_ = reinterpret_cast<const PageTableHeader*>(memory);
  if (table_->magic != PageTableHeader::kMagic || table_->version != PageTableHeader::kVersion) {
    reject(message, "its page table is not one that this build reads");
  }
}

bool PublishedModel::read_pages(const bus::Message& message, std::size_t arenas) {
  const PageEntry* const entries = model::page_entries(*table_);
  const std::size_t capacity = (tensors_.front().bytes() - sizeof(PageTableHeader)) / sizeof(PageEntry);
  for (std::size_t page = 0; page < capacity; ++page) {
    const PageEntry& entry = entries[page];
    const std::uint64_t generation = entry.generation.load(std::memory_order_acquire);
    const model::PageStructure now = entry.now;
    const PageBounds bounds = entry.bounds;
    std::atomic_thread_fence(std::memory_order_acquire);
    if (generation % 2 != 0 || entry.generation.load(std::memory_order_relaxed) != generation) return false;
    if (!model::is_present(now.state) || now.count == 0) continue;
    if (now.count > kPageLanes) reject(message, fmt::format("page {} holds {} Gaussians", page, now.count));
    const std::size_t arena = page / model::kArenaPages;
    // A slab has all of its arena, however many pages of it were in use when it was told of.
    const bool there = arena < arenas && (tensors_[1 + arena].slab() != nullptr ||
                                          page % model::kArenaPages < tensors_[1 + arena].dim(0));
    // The model may have grown since, as long as a copy over tcp took to be made: a later message has the page.
    if (!there) return false;
    ranges_.push_back({static_cast<std::uint32_t>(page) << kPageShift, now.count, now.frame_id,
                       now.state == model::PageState::Frozen ? 1U : 0U});
    bounds_.push_back(bounds);
    page_generations_.push_back(generation);
  }
  return true;
}

void PublishedModel::map_arenas(const PublishedModel* before) {
  const auto is_mapped = [&](const bus::SlabRange& range) {
    if (range.slabs().size() > tensors_.size() - 1) return false;
    for (std::size_t k = 0; k < range.slabs().size(); ++k) {
      if (range.slabs()[k]->id() != tensors_[k + 1].slab()->id()) return false;
    }
    return true;
  };
  if (before != nullptr && before->range_ && before->device_ == device_ && is_mapped(*before->range_)) {
    range_ = before->range_;
  } else {
    const std::size_t arena_bytes = model::kArenaPages * model::page_bytes(live_.layout);
    range_ = std::make_shared<bus::SlabRange>(device_, model::kMaxArenas * arena_bytes);
  }
  for (std::size_t k = range_->slabs().size(); k + 1 < tensors_.size(); ++k) range_->append(tensors_[k + 1].slab());
}

void PublishedModel::make_views(std::byte* pages, Need need) {
  const model::PageMemory memory(pages, live_.layout);
  const auto row = [&](model::Channel channel) { return model::rows_of(channel, live_.layout).first; };
  live_.count = ranges_.empty() ? 0 : ranges_.back().first + ranges_.back().count;
  live_.stride = kRowWords;
  live_.page_shift = kPageShift;
  live_.page_stride = memory.page_words;
  live_.ranges = ranges_;
  live_.generations = page_generations_;
  live_.normal = memory.value(memory.normal, 0);
  live_.surface_point = memory.value(memory.surface_point, 0);
  live_.visibility = memory.value(memory.visibility, 0);
  live_.gaussian_id = memory.wide(memory.gaussian_id, 0);
  average_ = live_;
  average_.parameters = memory.value(row(model::Channel::Average), 0);
  if (need == Need::Both) live_.parameters = memory.value(row(model::Channel::Parameters), 0);
}

bool PublishedModel::refresh() {
  if (!copies_) return still_valid();
  const std::size_t page_bytes = model::page_bytes(live_.layout);
  const std::uint32_t first_row = need_ == Need::Both ? 0 : model::rows_of(model::Channel::Average, live_.layout).first;
  const std::size_t begin = std::size_t{first_row} * kRowWords * sizeof(float);
  const std::size_t bytes = std::size_t{model::used_rows(live_.layout)} * kRowWords * sizeof(float) - begin;
  for (const IndexRange& range : ranges_) {
    const std::size_t page = range.first >> kPageShift;
    const bus::TensorView& arena = tensors_[1 + page / model::kArenaPages];
    bus::copy_memory(copies_.get() + page * page_bytes + begin, device_,
                     arena.data() + page % model::kArenaPages * page_bytes + begin, arena.memory(), bytes);
    if (arena.memory() != device_) copied_bytes_ += bytes;
  }
  bus::finish_copies();
  return still_valid();
}

bool PublishedModel::still_valid() const {
  std::atomic_thread_fence(std::memory_order_acquire);
  if (table_->generation.load(std::memory_order_acquire) != generation_) return false;
  const PageEntry* const entries = model::page_entries(*table_);
  for (std::size_t k = 0; k < ranges_.size(); ++k) {
    const PageEntry& entry = entries[ranges_[k].first >> kPageShift];
    if (entry.generation.load(std::memory_order_relaxed) != page_generations_[k]) return false;
  }
  return true;
}

}  // namespace splatbus
