#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <tuple>
#include <vector>

#include "gaussians/model.h"

namespace splatbus::raster::testing {

/// The Gaussians of a model in pages: those of one object together, cube by cube, some pages full and some not. What
/// lies beyond a page's Gaussians is garbage.
struct PagedModel {
  ParameterLayout layout;
  std::size_t channels, page_floats;
  std::vector<float> memory;
  std::vector<IndexRange> ranges;
  std::vector<PageBounds> bounds;
  GaussiansBuffer planar;  ///< the same Gaussians without pages, in the order of their indices

  PagedModel(const GaussiansBuffer& model, std::size_t fill)
      : layout(model.layout()),
        channels(static_cast<std::size_t>(layout.channels())),
        page_floats((channels + 5) * kPageLanes),  // parameters, normal, visibility, flags
        planar(layout, model.count()) {
    std::vector<std::uint32_t> source(model.count());
    std::iota(source.begin(), source.end(), 0U);
    const auto cell = [&](std::uint32_t i) {
      const auto along = [&](int axis) { return static_cast<int>(std::floor(model.view().plane(axis)[i])) + 32; };
      return (along(0) * 64 + along(1)) * 64 + along(2);
    };
    std::sort(source.begin(), source.end(), [&](std::uint32_t a, std::uint32_t b) {
      return std::tuple(model.object_id[a], cell(a), a) < std::tuple(model.object_id[b], cell(b), b);
    });
    for (std::size_t k = 0; k < source.size(); ++k) {
      const std::uint32_t i = source[k], frame_id = model.object_id[i];
      if (ranges.empty() || ranges.back().count == fill || ranges.back().frame_id != frame_id) {
        ranges.push_back({static_cast<std::uint32_t>(memory.size() / page_floats) * kPageLanes, 0, frame_id});
        memory.resize(memory.size() + page_floats, std::numeric_limits<float>::quiet_NaN());
      }
      put(model, i, memory.data() + memory.size() - page_floats + ranges.back().count++, k);
    }
    for (const IndexRange& range : ranges) bounds.push_back(bounds_of(view(), range));
  }

  [[nodiscard]] GaussiansView view() const { return view_of(memory.data(), page_floats); }
  [[nodiscard]] GaussiansView bounded_view() const {
    GaussiansView out = view();
    out.bounds = bounds;
    return out;
  }
  /// Of parameters that came back from the device, [pages][channels][kPageLanes].
  [[nodiscard]] GaussiansView view_of(const float* parameters, std::size_t page_stride) const {
    GaussiansView out;
    out.layout = layout;
    out.count = memory.size() / page_floats * kPageLanes;
    out.stride = kPageLanes;
    out.page_shift = kPageShift;
    out.page_stride = page_stride;
    out.ranges = ranges;
    out.parameters = parameters;
    if (parameters != memory.data()) return out;
    out.normal = parameters + channels * kPageLanes;
    out.visibility = parameters + (channels + 3) * kPageLanes;
    out.flags = reinterpret_cast<const std::uint32_t*>(parameters + (channels + 4) * kPageLanes);
    return out;
  }
  /// Calls visit(index, index without pages) for each Gaussian.
  template <class Visit>
  void for_each(const Visit& visit) const {
    std::size_t k = 0;
    for (const IndexRange& range : ranges) {
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) visit(i, k++);
    }
  }

 private:
  void put(const GaussiansBuffer& model, std::uint32_t i, float* lane, std::size_t k) {
    const std::size_t from = model.stride(), to = planar.stride();
    for (std::size_t c = 0; c < channels; ++c) {
      lane[c * kPageLanes] = planar.parameters[c * to + k] = model.parameters[c * from + i];
    }
    for (std::size_t c = 0; c < 3; ++c) {
      lane[(channels + c) * kPageLanes] = planar.normal[c * to + k] = model.normal[c * from + i];
    }
    lane[(channels + 3) * kPageLanes] = planar.visibility[k] = model.visibility[i];
    planar.flags[k] = model.flags[i];
    std::memcpy(lane + (channels + 4) * kPageLanes, &planar.flags[k], sizeof(std::uint32_t));
    planar.object_id[k] = model.object_id[i];
  }
};

}  // namespace splatbus::raster::testing
