#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <tuple>
#include <vector>

#include "gaussians/model.h"

namespace splatbus::test {

/// The Gaussians of a model in pages: those of one object together, cube by cube, `fill` of them in each page but the
/// last of an object. What lies beyond a page's Gaussians is garbage.
struct PagedModel {
  ParameterLayout layout;
  std::size_t channels, page_floats;
  std::vector<float> memory;  ///< a page: parameters, normal, visibility, flags, gaussian_id
  std::vector<IndexRange> ranges;
  std::vector<PageBounds> bounds;
  std::vector<std::uint32_t> source;  ///< of each Gaussian in the order of `ranges`: where the model has it
  GaussiansBuffer planar;             ///< the same Gaussians in that order, without pages

  PagedModel(const GaussiansView& model, std::size_t fill, float cube_m = 1)
      : layout(model.layout),
        channels(static_cast<std::size_t>(layout.channels())),
        page_floats((channels + 7) * kPageLanes),
        source(model.count),
        planar(layout, model.count) {
    const GaussiansBuffer from = GaussiansBuffer::copy_of(model);
    std::iota(source.begin(), source.end(), 0U);
    const auto cube = [&](std::uint32_t i) {
      const auto along = [&](int axis) { return static_cast<int>(std::floor(model.plane(axis)[i] / cube_m)) + 32; };
      return (along(0) * 64 + along(1)) * 64 + along(2);
    };
    std::sort(source.begin(), source.end(), [&](std::uint32_t a, std::uint32_t b) {
      return std::tuple(from.object_id[a], cube(a), a) < std::tuple(from.object_id[b], cube(b), b);
    });
    for (std::size_t k = 0; k < source.size(); ++k) {
      const std::uint32_t frame_id = from.object_id[source[k]];
      if (ranges.empty() || ranges.back().count == fill || ranges.back().frame_id != frame_id) {
        ranges.push_back({static_cast<std::uint32_t>(memory.size() / page_floats) * kPageLanes, 0, frame_id});
        memory.resize(memory.size() + page_floats, std::numeric_limits<float>::quiet_NaN());
      }
      put(from, source[k], memory.data() + memory.size() - page_floats, ranges.back().count++, k);
    }
    for (const IndexRange& range : ranges) bounds.push_back(bounds_of(view(), range));
  }

  [[nodiscard]] GaussiansView view() const {
    GaussiansView out = view_of(memory.data(), page_floats);
    out.normal = row(channels);
    out.visibility = row(channels + 3);
    out.flags = reinterpret_cast<const std::uint32_t*>(row(channels + 4));
    out.gaussian_id = reinterpret_cast<const std::uint64_t*>(row(channels + 5));
    return out;
  }
  [[nodiscard]] GaussiansView bounded_view() const {
    GaussiansView out = view();
    out.bounds = bounds;
    return out;
  }
  /// Of parameters that somebody else keeps, [pages][channels][kPageLanes] with so many floats from page to page.
  [[nodiscard]] GaussiansView view_of(const float* parameters, std::size_t page_stride) const {
    GaussiansView out;
    out.layout = layout;
    out.count = memory.size() / page_floats * kPageLanes;
    out.stride = kPageLanes;
    out.page_shift = kPageShift;
    out.page_stride = page_stride;
    out.ranges = ranges;
    out.parameters = parameters;
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
  [[nodiscard]] const float* row(std::size_t index) const { return memory.data() + index * kPageLanes; }

  void put(const GaussiansBuffer& from, std::uint32_t i, float* page, std::size_t lane, std::size_t k) {
    const auto plane = [&](std::size_t row, const auto& values, auto& flat, std::size_t rows) {
      for (std::size_t c = 0; c < rows; ++c) {
        const auto value = flat[c * planar.stride() + k] = values[c * from.stride() + i];
        std::memcpy(page + (row + c) * kPageLanes + lane * (sizeof(value) / sizeof(float)), &value, sizeof(value));
      }
    };
    plane(0, from.parameters, planar.parameters, channels);
    plane(channels, from.normal, planar.normal, 3);
    plane(channels + 3, from.visibility, planar.visibility, 1);
    plane(channels + 4, from.flags, planar.flags, 1);
    plane(channels + 5, from.gaussian_id, planar.gaussian_id, 1);
    planar.object_id[k] = from.object_id[i];
  }
};

}  // namespace splatbus::test
