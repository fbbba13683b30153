#pragma once

#include <algorithm>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "device/memory.h"
#include "gaussians/model.h"
#include "model/channels.h"
#include "model/page_table.h"
#include "wire/model_generated.h"
#include "wire/topics.h"

namespace splatbus::model {

/// Says model/published as the trainer does, of models that lie whole in a buffer: each in slabs of its own, which the
/// next but seven takes over, in memory of some device. The Gaussians of one object keep their order and lie in pages
/// of their own, those of the lowest id first; averages are the parameters.
class PagedPublisher {
 public:
  explicit PagedPublisher(std::shared_ptr<bus::Context> context, Device device = Device::Cpu)
      : context_(std::move(context)), device_(device) {}

  bool frozen = false;             ///< all pages are
  bool keeps_generations = false;  ///< of pages whose content is what it was, as the trainer does

  /// Returns the index of each Gaussian.
  std::vector<std::uint32_t> publish(const bus::Publisher& publisher, const GaussiansBuffer& model,
                                     std::uint64_t generation, std::uint64_t insert_epoch = 0,
                                     const std::vector<std::uint64_t>& batches = {}) {
    const ParameterLayout& layout = model.layout();
    const auto table_bytes = static_cast<std::uint32_t>(page_table_bytes(kArenaPages));
    const auto& [table_slab, pages_slab] = next_slabs(layout);
    // Whoever still reads what lay there sees that it has gone.
    std::memset(table_slab->slot_data(0), 0, table_bytes);
    const PageTable table = PageTable::begin(table_slab->slot_data(0), layout, kArenaPages);
    table.header().generation = generation;

    std::map<std::uint32_t, std::vector<std::size_t>> of_frame;
    for (std::size_t i = 0; i < model.count(); ++i) of_frame[model.object_id[i]].push_back(i);
    std::vector<std::uint32_t> index(model.count());
    std::uint32_t page = 0;
    for (const auto& [frame_id, members] : of_frame) {
      for (std::size_t k = 0; k < members.size(); k += kPageLanes, ++page) {
        const std::size_t count = std::min<std::size_t>(kPageLanes, members.size() - k);
        PageEntry& entry = table.entry(page);
        entry.now = {.state = frozen ? PageState::Frozen : PageState::Active,
                     .frame_id = frame_id,
                     .count = static_cast<std::uint32_t>(count)};
        for (std::size_t lane = 0; lane < count; ++lane) {
          index[members[k + lane]] = page * kPageLanes + static_cast<std::uint32_t>(lane);
        }
        const PageContent content{frame_id, count, write_page(*pages_slab, page, model, {members.data() + k, count})};
        if (!(content == contents_[page]) || !keeps_generations) page_generations_[page] = 2 * generation;
        contents_[page] = content;
        entry.generation = page_generations_[page];
      }
    }
    const auto announce = [](const char* name, const bus::Slab& slab, std::vector<std::uint32_t> shape,
                             bus::ElementType type) {
      const std::size_t bytes = bus::tensor_bytes(shape, type);
      return bus::OutgoingTensor{
          .name = name, .shape = std::move(shape), .type = type, .span = slab.span(0, 0, bytes, slab.sequence(0))};
    };
    const bus::MessageInfo info{
        .tensors = {announce("page_table", *table_slab, {table_bytes}, bus::ElementType::U8),
                    announce("pages-0", *pages_slab, {kArenaPages, page_words(layout)}, bus::ElementType::U32)}};
    publisher.publish(topics::kModelPublished, info, [&](flatbuffers::FlatBufferBuilder& builder, auto header) {
      const auto list = builder.CreateVector(batches);
      return wire::CreateModelPublished(
          builder, header, generation, model.count(), kArenaPages, 1, page, kPageLanes, page_words(layout),
          layout.appearance == Appearance::Transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
          static_cast<std::uint8_t>(layout.sh_degree), 0, insert_epoch, list);
    });
    return index;
  }

 private:
  struct PageContent {
    std::uint32_t frame_id = 0;
    std::size_t count = 0, hash = 0;
    bool operator==(const PageContent&) const = default;
  };
  using Slabs = std::pair<std::shared_ptr<bus::Slab>, std::shared_ptr<bus::Slab>>;

  const Slabs& next_slabs(const ParameterLayout& layout) {
    if (layout != layout_) {
      slabs_.clear();
      turn_ = 0;
    }
    layout_ = layout;
    const std::size_t turn = turn_++ % 8;
    if (turn == slabs_.size()) {
      std::string suffix = std::to_string(turn);
      suffix.insert(suffix.begin(), '-');
      slabs_.emplace_back(context_->create_slab("page-table" + suffix, 1, page_table_bytes(kArenaPages)),
                          context_->create_slab("pages" + suffix, 1, kArenaPages * page_bytes(layout), 10000, device_));
    }
    return slabs_[turn];
  }

  /// Returns a hash of what it has written.
  std::size_t write_page(const bus::Slab& slab, std::uint32_t page, const GaussiansBuffer& model,
                         std::span<const std::size_t> members) const {
    const ParameterLayout& layout = model.layout();
    std::vector<std::uint32_t> words(page_words(layout), 0);
    const auto put = [&](Channel channel, const auto& planes, std::size_t channels) {
      using Element = std::decay_t<decltype(planes[0])>;
      auto* const row =
          reinterpret_cast<Element*>(words.data() + std::size_t{rows_of(channel, layout).first} * kRowWords);
      for (std::size_t c = 0; c < channels; ++c) {
        for (std::size_t lane = 0; lane < members.size(); ++lane) {
          row[c * kRowWords + lane] = planes[c * model.stride() + members[lane]];
        }
      }
    };
    const auto channels = static_cast<std::size_t>(layout.channels());
    put(Channel::Parameters, model.parameters, channels);
    put(Channel::Average, model.parameters, channels);
    put(Channel::Normal, model.normal, 3);
    put(Channel::SurfacePoint, model.surface_point, 3);
    put(Channel::Visibility, model.visibility, 1);
    put(Channel::GaussianId, model.gaussian_id, 1);
    const device::StreamView stream = device::thread_stream(device_);
    device::copy(stream, slab.slot_data(0) + page * page_bytes(layout), words.data(), words.size() * sizeof(words[0]));
    stream.wait();
    return std::hash<std::string_view>()(
        {reinterpret_cast<const char*>(words.data()), words.size() * sizeof(words[0])});
  }

  std::shared_ptr<bus::Context> context_;
  Device device_;
  ParameterLayout layout_;
  std::size_t turn_ = 0;
  std::vector<Slabs> slabs_;
  std::map<std::uint32_t, PageContent> contents_;
  std::map<std::uint32_t, std::uint64_t> page_generations_;
};

}  // namespace splatbus::model
