#include "trainer/visibility_ring.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace splatbus::trainer {

VisibilityRing::OfIndex VisibilityRing::make(std::size_t size) const {
  auto buffer = std::make_shared<device::Buffer<std::uint8_t>>(stream_, size);
  std::uint8_t* const values = buffer->data();
  return {.values = {std::move(buffer), values}, .size = size};
}

void VisibilityRing::take(const VisibilityCommand& relit, std::span<const std::uint64_t> needed) {
  auto* const values = reinterpret_cast<std::uint8_t*>(relit.visibility.get());
  const std::vector<model::LaneRange> pages = store_.unchanged_since(relit.model_generation, relit.count);
  const GaussiansView view = store_.view();
  const bool newest = of_version_.empty() || relit.scene_version >= of_version_.rbegin()->first;
  if (newest) store_.set_visibility(values, pages);
  OfIndex& of_index = of_version_[relit.scene_version];
  if (pages.size() == view.ranges.size() && relit.count >= view.count) {
    of_index = {.values = {relit.visibility, values}, .size = relit.count};
  } else {
    of_index = make(view.count);
    kernels::read_visibility(stream_, store_.memory(), store_.device_ranges(),
                             static_cast<std::uint32_t>(view.ranges.size()), of_index.values.get());
    kernels::copy_visibility(stream_, values, pages, of_index.values.get());
  }
  drop(needed);
}

void VisibilityRing::drop(std::span<const std::uint64_t> needed) {
  const auto newest = std::prev(of_version_.end());
  const std::size_t most =
      std::clamp<std::size_t>(kMaxBytes / std::max<std::size_t>(1, newest->second.size), 1, kMaxVersions);
  std::erase_if(of_version_, [&, version = newest->first](const auto& entry) {
    return entry.first != version && !std::binary_search(needed.begin(), needed.end(), entry.first);
  });
  while (of_version_.size() > most) of_version_.erase(of_version_.begin());
}

void VisibilityRing::follow(const kernels::PagedGaussians& fresh, const model::Moves& moves) {
  const std::size_t count = store_.view().count;
  for (auto& [version, of_index] : of_version_) {
    if (of_index.size < count) {
      OfIndex larger = make(count + count / 4);
      device::copy(stream_, larger.values.get(), of_index.values.get(), of_index.size);
      of_index = std::move(larger);
    }
    kernels::read_visibility(stream_, fresh.memory, fresh.ranges, fresh.range_count, of_index.values.get());
    kernels::move_values(stream_, of_index.values.get(), moves);
  }
}

std::shared_ptr<const std::uint8_t> VisibilityRing::find(std::uint64_t scene_version) const {
  const auto found = of_version_.find(scene_version);
  return found == of_version_.end() ? nullptr : found->second.values;
}

std::vector<std::uint64_t> VisibilityRing::versions() const {
  std::vector<std::uint64_t> all;
  all.reserve(of_version_.size());
  for (const auto& [version, of_index] : of_version_) all.push_back(version);
  return all;
}

}  // namespace splatbus::trainer
