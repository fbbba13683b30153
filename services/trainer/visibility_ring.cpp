#include "trainer/visibility_ring.h"

#include <algorithm>
#include <utility>

namespace splatbus::trainer {

VisibilityRing::OfIndex VisibilityRing::make(std::size_t stride, const std::vector<std::uint32_t>& light_ids) const {
  auto buffer = std::make_shared<device::Buffer<std::uint8_t>>(stream_, stride * light_ids.size());
  std::uint8_t* const values = buffer->data();
  device::fill(stream_, values, 255, buffer->bytes());
  return {.values = {std::move(buffer), values}, .stride = stride, .light_ids = light_ids, .parts = {}};
}

void VisibilityRing::take(const VisibilityCommand& relit, std::span<const std::uint64_t> needed) {
  auto* const values = reinterpret_cast<std::uint8_t*>(relit.visibility.get());
  std::vector<model::LaneRange> pages = store_.unchanged_since(relit.model_generation, relit.count);
  const bool is_part = relit.parts > 0;
  if (is_part) {
    std::erase_if(pages, [&](const model::LaneRange& page) {
      return !std::ranges::binary_search(relit.pages, page.first >> kPageShift);
    });
  }
  const GaussiansView view = store_.view();
  const bool newest = of_version_.empty() || relit.scene_version >= of_version_.rbegin()->first;
  if (newest) store_.set_visibility(values, pages);
  OfIndex& of_index = of_version_[relit.scene_version];
  if (!is_part && pages.size() == view.ranges.size() && relit.count >= view.count) {
    of_index = {.values = {relit.visibility, values}, .stride = relit.count, .light_ids = relit.light_ids, .parts = {}};
  } else {
    const bool goes_on =
        is_part && of_index.values && of_index.light_ids == relit.light_ids && of_index.stride >= view.count;
    if (!goes_on) of_index = of_model(relit.light_ids);
    kernels::copy_visibility(stream_, {values, relit.count, of_index.rows()}, pages,
                             {of_index.values.get(), of_index.stride, of_index.rows()});
    if (is_part) {
      if (!goes_on) of_index.whole = false;
      if (std::exchange(of_index.division, relit.division) != relit.division) of_index.parts.clear();
      of_index.parts.insert(relit.part);
      of_index.whole = of_index.whole || of_index.parts.size() == relit.parts;
    }
  }
  drop(needed);
}

VisibilityRing::OfIndex VisibilityRing::of_model(const std::vector<std::uint32_t>& light_ids) const {
  const GaussiansView view = store_.view();
  OfIndex of_index = make(view.count, light_ids);
  kernels::read_visibility(stream_, store_.memory(), store_.device_ranges(),
                           static_cast<std::uint32_t>(view.ranges.size()), of_index.row(0));
  return of_index;
}

void VisibilityRing::drop(std::span<const std::uint64_t> needed) {
  const std::uint64_t newest = of_version_.rbegin()->first;
  std::erase_if(of_version_, [&](const auto& entry) {
    return entry.first != newest && !std::binary_search(needed.begin(), needed.end(), entry.first);
  });
  std::size_t bytes = 0;
  for (const auto& [version, of_index] : of_version_) bytes += of_index.bytes();
  while (of_version_.size() > kMaxVersions || (of_version_.size() > 1 && bytes > kMaxBytes)) {
    bytes -= of_version_.begin()->second.bytes();
    of_version_.erase(of_version_.begin());
  }
}

void VisibilityRing::follow(const kernels::PagedGaussians& fresh, const model::Moves& moves) {
  const std::size_t count = store_.view().count;
  for (auto& [version, of_index] : of_version_) {
    if (of_index.stride < count) {
      OfIndex larger = make(count + count / 4, of_index.light_ids);
      larger.division = of_index.division;
      larger.parts = of_index.parts;
      larger.whole = of_index.whole;
      for (std::uint32_t light = 0; light < of_index.rows(); ++light) {
        device::copy(stream_, larger.row(light), of_index.row(light), of_index.stride);
      }
      of_index = larger;
    }
    kernels::read_visibility(stream_, fresh.memory, fresh.ranges, fresh.range_count, of_index.row(0));
    for (std::uint32_t light = 0; light < of_index.rows(); ++light) {
      if (light > 0) kernels::set_values(stream_, of_index.row(light), fresh.ranges, fresh.range_count, 255);
      kernels::move_values(stream_, of_index.row(light), moves);
    }
  }
}

SceneVisibility VisibilityRing::find(const SceneState& scene) const {
  const auto found = of_version_.find(scene.version);
  if (found == of_version_.end() || !found->second.whole || found->second.light_ids != light_ids(scene.light))
    return {};
  return {.values = found->second.values, .stride = found->second.stride, .rows = found->second.rows()};
}

std::vector<PairedVersion> VisibilityRing::versions() const {
  std::vector<PairedVersion> all;
  all.reserve(of_version_.size());
  for (const auto& [version, of_index] : of_version_) {
    if (of_index.whole) all.push_back({version, of_index.light_ids});
  }
  return all;
}

}  // namespace splatbus::trainer
