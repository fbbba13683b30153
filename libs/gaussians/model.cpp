#include "gaussians/model.h"

#include <algorithm>

namespace splatbus {
namespace {

/// Moves `rows` planes from one stride to another; columns beyond `count` become zero.
template <typename T>
void restride(std::vector<T>& planes, std::size_t rows, std::size_t count, std::size_t from, std::size_t to) {
  std::vector<T> moved(rows * to);
  for (std::size_t row = 0; row < rows; ++row) {
    const auto begin = planes.begin() + static_cast<std::ptrdiff_t>(row * from);
    std::copy(begin, begin + static_cast<std::ptrdiff_t>(count), moved.begin() + static_cast<std::ptrdiff_t>(row * to));
  }
  planes.swap(moved);
}

template <typename T>
void clear_columns(std::vector<T>& planes, std::size_t rows, std::size_t stride, std::size_t first, std::size_t last) {
  for (std::size_t row = 0; row < rows; ++row) {
    const auto begin = planes.begin() + static_cast<std::ptrdiff_t>(row * stride);
    std::fill(begin + static_cast<std::ptrdiff_t>(first), begin + static_cast<std::ptrdiff_t>(last), T{});
  }
}

template <typename T>
void copy_channels(const T* source, std::size_t source_stride, std::size_t channels, std::size_t count, T* target,
                   std::size_t target_stride) {
  for (std::size_t c = 0; c < channels; ++c) std::copy_n(source + c * source_stride, count, target + c * target_stride);
}

}  // namespace

GaussiansBuffer::GaussiansBuffer(ParameterLayout layout, std::size_t count) : layout_(layout) {
  resize(count);
}

void GaussiansBuffer::resize(std::size_t count) {
  const auto channels = static_cast<std::size_t>(layout_.channels());
  const auto each_plane_set = [&](const auto& apply) {
    apply(parameters, channels);
    apply(normal, 3);
    apply(surface_point, 3);
    apply(visibility, 1);
    apply(object_id, 1);
    apply(flags, 1);
    apply(gaussian_id, 1);
  };
  if (count > stride_) {
    // Geometric growth, so that appending one at a time stays linear.
    const std::size_t stride = count_ == 0 ? count : std::max(count, stride_ + stride_ / 2);
    each_plane_set(
        [&](auto& planes, std::size_t rows) { restride(planes, rows, std::min(count_, count), stride_, stride); });
    stride_ = stride;
  } else if (count < count_) {
    // Cleared when they leave, so that whoever comes back into these columns finds zeros.
    each_plane_set([&](auto& planes, std::size_t rows) { clear_columns(planes, rows, stride_, count, count_); });
  }
  count_ = count;
}

GaussiansView GaussiansBuffer::view() const {
  GaussiansView view;
  view.layout = layout_;
  view.count = count_;
  view.stride = stride_;
  view.parameters = parameters.data();
  view.normal = normal.data();
  view.surface_point = surface_point.data();
  view.visibility = visibility.data();
  view.object_id = object_id.data();
  view.flags = flags.data();
  view.gaussian_id = gaussian_id.data();
  return view;
}

GaussiansBuffer GaussiansBuffer::copy_of(const GaussiansView& view) {
  const IndexRange all{.count = static_cast<std::uint32_t>(view.count)};
  const std::span<const IndexRange> ranges = view.has_pages() ? view.ranges : std::span(&all, 1);
  std::size_t count = 0;
  for (const IndexRange& range : ranges) count += range.count;
  GaussiansBuffer out(view.layout, count);
  const bool has_surface_point = view.surface_point != nullptr || view.parameters == nullptr;
  const float* const surface_point = has_surface_point ? view.surface_point : view.plane(ParameterLayout::kMean);
  std::size_t first = 0;
  for (const IndexRange& range : ranges) {
    const auto copy = [&](const auto* source, std::size_t channels, auto& target) {
      if (source == nullptr) return;
      const std::size_t offset = sizeof(*source) == 8 ? view.wide_offset(range.first) : view.offset(range.first);
      copy_channels(source + offset, view.stride, channels, range.count, target.data() + first, out.stride_);
    };
    copy(view.parameters, static_cast<std::size_t>(view.layout.channels()), out.parameters);
    copy(view.normal, 3, out.normal);
    copy(surface_point, 3, out.surface_point);
    copy(view.visibility, 1, out.visibility);
    copy(view.object_id, 1, out.object_id);
    copy(view.flags, 1, out.flags);
    copy(view.gaussian_id, 1, out.gaussian_id);
    if (view.has_pages())
      std::fill_n(out.object_id.begin() + static_cast<std::ptrdiff_t>(first), range.count, range.frame_id);
    first += range.count;
  }
  return out;
}

}  // namespace splatbus
