// How an Optimizer hands over what it keeps for each Gaussian, and goes on with what another has left.
#include "trainer/handover.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <vector>

#include "trainer/optimizer.h"

namespace splatbus::trainer {

std::size_t Optimizer::handover_bytes() const {
  const auto channels = static_cast<std::size_t>(store_.layout().channels());
  std::size_t bytes = sizeof(HandoverHeader);
  for (const IndexRange& range : store_.view().ranges) {
    bytes += trainer::handover_bytes(step_->moments_of(range.first >> kPageShift), channels);
  }
  return bytes;
}

void Optimizer::save(std::byte* memory) const {
  const std::span<const IndexRange> ranges = store_.view().ranges;
  const auto channels = static_cast<std::size_t>(store_.layout().channels());
  HandoverHeader header;
  header.channels = static_cast<std::uint32_t>(channels);
  header.step = store_.step();
  header.pages = static_cast<std::uint32_t>(ranges.size());
  std::memcpy(memory, &header, sizeof(header));
  memory += sizeof(header);
  const device::StreamView stream = step_->stream();
  const model::PageMemory& model = store_.memory();
  for (const IndexRange& range : ranges) {
    auto& page = *new (memory) HandoverPage;
    page.page = range.first >> kPageShift;
    page.count = range.count;
    page.kind = step_->moments_of(page.page);
    device::copy(stream, page.gaussian_id, model.wide(model.gaussian_id, range.first),
                 range.count * sizeof(std::uint64_t));
    device::copy(stream, page.created_step, created_step_.data() + range.first, range.count * sizeof(std::uint64_t));
    if (page.kind != raster::PageMoments::None) {
      step_->save_moments(page.page, reinterpret_cast<float*>(memory + sizeof(HandoverPage)));
    }
    memory += trainer::handover_bytes(page.kind, channels);
  }
  stream.wait();
}

Restored Optimizer::restore(std::span<const std::byte> memory) {
  const auto channels = static_cast<std::size_t>(store_.layout().channels());
  HandoverHeader header;
  if (memory.size() < sizeof(header)) return {.refusal = "it is too small"};
  std::memcpy(&header, memory.data(), sizeof(header));
  if (header.magic != HandoverHeader::kMagic || header.version != HandoverHeader::kVersion) {
    return {.refusal = "it is of another version"};
  }
  if (header.channels != channels || header.step != store_.step()) {
    return {.refusal = fmt::format("it is of {} channels at step {}, the model has {} at step {}", header.channels,
                                   header.step, channels, store_.step())};
  }
  const std::span<const IndexRange> ranges = store_.view().ranges;
  const device::StreamView stream = step_->stream();
  const model::PageMemory& model = store_.memory();
  std::vector<std::uint64_t> ids(kPageLanes);
  Restored restored;
  std::size_t at = sizeof(header);
  for (std::uint32_t k = 0; k < header.pages; ++k) {
    if (memory.size() - at < sizeof(HandoverPage)) return {.refusal = "it ends early"};
    const auto& page = *reinterpret_cast<const HandoverPage*>(memory.data() + at);
    const raster::PageMoments kind = page.kind;
    const std::size_t bytes = kind <= raster::PageMoments::Rests ? trainer::handover_bytes(kind, channels) : SIZE_MAX;
    if (memory.size() - at < bytes) return {.refusal = "it ends early"};
    const auto* const moments = reinterpret_cast<const float*>(memory.data() + at + sizeof(HandoverPage));
    at += bytes;
    const auto range = std::ranges::find(ranges, page.page, [](const IndexRange& r) { return r.first >> kPageShift; });
    if (range == ranges.end() || range->count != page.count) continue;
    device::copy(stream, ids.data(), model.wide(model.gaussian_id, range->first), page.count * sizeof(std::uint64_t));
    stream.wait();
    if (!std::equal(ids.begin(), ids.begin() + page.count, page.gaussian_id)) continue;
    device::copy(stream, created_step_.data() + range->first, page.created_step, page.count * sizeof(std::uint64_t));
    step_->restore_moments(page.page, kind, moments);
    restored.pages += 1;
    restored.gaussians += page.count;
  }
  stream.wait();
  return restored;
}

}  // namespace splatbus::trainer
