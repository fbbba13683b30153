// A tick's values of Gaussians that are held.

#include <algorithm>
#include <utility>

#include "stream/codecs.h"
#include "stream/delta_selection.h"
#include "stream/pieces.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

// A packet's worth: large enough that its tables pay, small enough that a slow viewer can be sent some of them.
constexpr double kPacketBytes = 12'000;
constexpr double kObjectBytes = 2;

}  // namespace

/// What of a page's values is to be sent, by index of the attribute; lanes ascend.
struct StreamModel::PageValues {
  std::uint32_t page = 0;
  std::uint64_t place = 0;
  double bytes = 0;
  float steps = 0;
  std::vector<std::vector<std::uint32_t>> lanes;  ///< [attributes]
  std::vector<std::uint32_t> objects;             ///< lanes that are another object's now
};

bool StreamModel::is_idle(std::uint32_t page) const {
  std::uint32_t every = 1;
  for (const AttributeSchedule& schedule : options_.schedules) every = std::max(every, schedule.every);
  return page < known_.size() && known_[page].idle_ticks > (options_.calm_ticks + 2) * every;
}

// Of pages that nobody holds nothing is to be sent. Of the others each has been looked at for as long as values take to
// calm down, and once more, before it is left alone.
std::vector<std::uint32_t> StreamModel::busy_blocks() {
  std::vector<std::uint32_t> blocks;
  for (const auto& [number, page] : held_.pages) {
    if (!anybody_holds(number) || is_idle(number)) continue;
    ++busy_pages_;
    ++known(number).idle_ticks;
    for (std::uint32_t k = 0; k < HeldPage::blocks_of(page.count); ++k) blocks.push_back(page.blocks[k]);
  }
  std::ranges::sort(blocks);
  return blocks;
}

std::vector<std::uint32_t> StreamModel::rows_of_other_objects(std::span<const std::uint32_t> blocks) const {
  std::vector<std::vector<std::uint32_t>> found(pieces_of(blocks.size(), kPieceBlocks));
  for_each_piece(blocks, kPieceBlocks, [&](std::size_t k, std::span<const std::uint32_t> piece) {
    for (const std::uint32_t block : piece) {
      for (std::uint32_t row = block * kBlockRows; row < (block + 1) * kBlockRows; ++row) {
        const std::uint32_t column = column_of_row_[row];
        if (column == kNotHeld || target_.object_id[column] == held_.gaussians.object_id[row]) continue;
        found[k].push_back(row);
      }
    }
  });
  std::vector<std::uint32_t> rows;
  for (const auto& part : found) rows.insert(rows.end(), part.begin(), part.end());
  return rows;
}

void StreamModel::tick_values(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects) {
  busy_pages_ = 0;
  if (budget_bytes <= 0) return;
  const std::vector<std::uint32_t> blocks = busy_blocks();
  share_.resize(held_.rows());
  picture_share(held_.gaussians, held_.layout, blocks, viewers, objects, share_);
  const auto selected = selection_.select(held_.gaussians, target_, column_of_row_, blocks, share_, budget_bytes);

  std::map<std::uint32_t, PageValues> pages;
  const auto& attributes = held_.layout.attributes();
  for (const SelectedRows& rows : selected) {
    const auto a = static_cast<std::size_t>(held_.layout.find(rows.attribute) - attributes.data());
    const double bytes = selection_.bytes_per_entry(rows.attribute);
    for (std::size_t i = 0; i < rows.rows.size(); ++i) {
      PageValues& page = pages[page_of_row(rows.rows[i])];
      page.lanes.resize(attributes.size());
      page.lanes[a].push_back(lane_of_row(rows.rows[i]));
      page.bytes += bytes;
      page.steps += rows.steps[i];
    }
  }
  for (const std::uint32_t row : rows_of_other_objects(blocks)) {
    PageValues& page = pages[page_of_row(row)];
    page.lanes.resize(attributes.size());
    page.objects.push_back(lane_of_row(row));
    page.bytes += kObjectBytes;
    page.steps += kAbsentSteps;
  }
  for (auto& [number, quiet] : quiet_) ++quiet.ticks;
  const auto is_busy = [&](std::uint32_t number) { quiet_[number].ticks = known(number).idle_ticks = 0; };
  for (const std::uint32_t block : selection_.left_blocks()) is_busy(page_of_block_[block]);
  std::vector<PageValues> order;
  for (auto& [number, page] : pages) {
    is_busy(number);
    page.page = number;
    page.place = place_of(number);
    page.steps /= static_cast<float>(held_.find(number)->count);
    for (auto& lanes : page.lanes) std::ranges::sort(lanes);
    std::ranges::sort(page.objects);
    order.push_back(std::move(page));
  }
  std::ranges::sort(order, {}, &PageValues::place);
  std::size_t first = 0;
  double bytes = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    if (k > first && (bytes + order[k].bytes > kPacketBytes || k - first >= kPacketPages)) {
      emit_values(std::span(order).subspan(first, k - first));
      first = k;
      bytes = 0;
    }
    bytes += order[k].bytes;
  }
  if (first < order.size()) emit_values(std::span(order).subspan(first));
}

void StreamModel::emit_values(std::span<const PageValues> pages) {
  const std::uint32_t version = version_ + 1;
  std::vector<wire::PageStep> steps;
  std::vector<DeltaPacket::Step> infos;
  for (const PageValues& values : pages) {
    const HeldPage& page = *held_.find(values.page);
    steps.emplace_back(values.page, values.page, page.version, version, page.count, 0, 0);
    infos.push_back({.page = values.page,
                     .base = values.page,
                     .from_version = page.version,
                     .version = version,
                     .count = page.count,
                     .other_lanes = false,
                     .steps = values.steps});
  }
  Bytes payload;
  SlotIds objects;
  std::uint32_t lanes = 0;
  for (const PageValues& values : pages) {
    const HeldPage& page = *held_.find(values.page);
    for (const std::uint32_t lane : values.objects) {
      objects.slots.push_back(lanes + lane);
      objects.ids.push_back(target_.object_id[column_of_row_[page.row(lane)]]);
    }
    lanes += page.count;
  }
  const Payload changed = objects.slots.empty() ? Payload{} : encode_slot_ids(objects);
  append(payload, changed.bytes);
  const wire::Section changed_section(static_cast<std::uint32_t>(objects.slots.size()), changed.raw_bytes,
                                      static_cast<std::uint32_t>(changed.bytes.size()));
  std::vector<wire::ValueSection> sections;
  const auto& attributes = held_.layout.attributes();
  for (std::size_t a = 0; a < attributes.size(); ++a) {
    const AttributeChannels& channels = attributes[a];
    Delta delta;
    std::vector<std::uint32_t> rows;
    std::vector<int> shifts;
    std::uint32_t first = 0;
    for (const PageValues& values : pages) {
      const HeldPage& page = *held_.find(values.page);
      for (const std::uint32_t lane : values.lanes[a]) {
        delta.slots.push_back(first + lane);
        rows.push_back(page.row(lane));
        shifts.push_back(precision_.shift(a, precision_.of(target_, column_of_row_[rows.back()])));
      }
      first += page.count;
    }
    if (rows.empty()) continue;
    for (int c = channels.first; c < channels.first + channels.channels; ++c) {
      auto& plane = delta.residuals.emplace_back();
      for (std::size_t i = 0; i < rows.size(); ++i) {
        const std::int32_t value = target_.channels[c][column_of_row_[rows[i]]];
        plane.push_back(Precision::rounded(value, shifts[i], channels) - held_.gaussians.channels[c][rows[i]]);
      }
    }
    const Payload encoded = encode_delta(delta);
    sections.emplace_back(channels.attribute, static_cast<std::uint32_t>(rows.size()), encoded.raw_bytes,
                          static_cast<std::uint32_t>(encoded.bytes.size()));
    append(payload, encoded.bytes);
    selection_.learn_cost(channels.attribute, rows.size(), encoded.bytes.size());
  }
  EncodedPacket packet = writer_.write(
      held_.epoch, 0, wire::Body::PageDelta,
      [&](auto& builder) {
        const auto steps_at = builder.CreateVectorOfStructs(steps);
        const auto values_at = builder.CreateVectorOfStructs(sections);
        return wire::CreatePageDelta(builder, steps_at, 0, nullptr, 0, nullptr,
                                     objects.slots.empty() ? nullptr : &changed_section, values_at);
      },
      std::move(payload));
  (void)emit(std::move(packet), std::move(infos), {});
}

}  // namespace splatbus::stream
