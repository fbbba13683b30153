#include "stream/display_gaussians.h"

#include <algorithm>
#include <cassert>
#include <numeric>

#include "stream/channel_kernels.h"

namespace splatbus::stream {

namespace {

constexpr int kAll = 255;  // of a light is seen

/// Host memory as the stream's device reads it.
template <class T>
const T* on_device(device::Buffer<T>& buffer, const std::vector<T>& host) {
  if (!buffer.stream().on_cuda()) return host.data();
  buffer.assign(host);
  return buffer.data();
}

}  // namespace

DisplayGaussians::DisplayGaussians(const StreamLayout& layout, device::StreamView stream)
    : layout_(layout),
      stream_(stream),
      row_count_(layout.parameters().channels() + (layout.parameters().appearance == Appearance::Transfer ? 4 : 0)),
      rows_(stream),
      object_id_(stream),
      seen_(stream),
      others_(stream),
      moved_(stream),
      moved_bytes_(stream),
      moved_ids_(stream),
      columns_(stream),
      values_(stream) {}

int DisplayGaussians::row_of(Attribute attribute) const {
  const int channels = layout_.parameters().channels();
  if (attribute == Attribute::Normal) return channels;
  return attribute == Attribute::Visibility ? channels + 3 : parameter_channel(attribute);
}

void DisplayGaussians::reserve(std::size_t columns) {
  if (columns <= stride_) return;
  const std::size_t stride = std::max({columns, 2 * stride_, std::size_t{4096}});
  device::Buffer<float> rows(stream_, static_cast<std::size_t>(row_count_) * stride);
  for (int r = 0; r < row_count_; ++r) {
    device::copy(stream_, rows.data() + static_cast<std::size_t>(r) * stride, row(r), count_ * sizeof(float));
  }
  device::Buffer<std::uint32_t> object_id(stream_, stride);
  device::copy(stream_, object_id.data(), object_id_.data(), count_ * sizeof(std::uint32_t));
  if (!lights_.empty()) {
    device::Buffer<std::uint8_t> seen(stream_);
    gather_lights(lights_, stride, seen);
    seen_ = std::move(seen);
  }
  rows_ = std::move(rows);
  object_id_ = std::move(object_id);
  stride_ = stride;
}

void DisplayGaussians::apply(const DisplayChanges& changes) {
  for (const DisplayChange& change : changes.list()) {
    std::visit([this](const auto& c) { apply(c); }, change);
  }
}

void DisplayGaussians::apply(const DisplayReset& change) {
  *this = DisplayGaussians(change.layout, stream_);
}

void DisplayGaussians::apply(const DisplayAppend& change) {
  const std::size_t first = count_, added = change.gaussians.count();
  reserve(first + added);
  count_ = first + added;
  std::vector<std::uint32_t> columns(added);
  std::iota(columns.begin(), columns.end(), static_cast<std::uint32_t>(first));
  apply(DisplayObjects{columns, change.gaussians.object_id});
  for (const AttributeChannels& a : layout_.attributes()) {
    DisplayValues values{.attribute = a.attribute, .columns = columns, .values = {}};
    for (int c = a.first; c < a.first + a.channels; ++c) {
      const std::vector<std::int32_t>& plane = change.gaussians.channels[c];
      values.values.insert(values.values.end(), plane.begin(), plane.end());
    }
    if (a.attribute == Attribute::Visibility && !lights_.empty()) {
      apply(DisplaySeen{0, columns, Bytes(values.values.begin(), values.values.end())});
    }
    apply(values);
  }
  for (const std::uint32_t id : lights_) device::fill(stream_, seen_row(id) + first, kAll, added);
  stream_.wait();
}

void DisplayGaussians::apply(const DisplayValues& change) {
  const AttributeChannels& a = layout_.at(change.attribute);
  assert(change.values.size() == static_cast<std::size_t>(a.channels) * change.columns.size());
  kernels::dequantize({.offset = a.quantizer.offset,
                       .step = a.quantizer.step,
                       .kind = coding_of(change.attribute),
                       .channels = a.channels,
                       .row = row_of(change.attribute)},
                      on_device(values_, change.values), on_device(columns_, change.columns),
                      static_cast<std::uint32_t>(change.columns.size()), rows_.data(), stride_, stream_);
  stream_.wait();
}

void DisplayGaussians::apply(const DisplayObjects& change) {
  kernels::scatter(on_device(moved_ids_, change.object_ids), on_device(columns_, change.columns),
                   static_cast<std::uint32_t>(change.columns.size()), object_id_.data(), stream_);
  stream_.wait();
}

std::uint8_t* DisplayGaussians::seen_row(std::uint32_t light_id) const {
  const auto found = std::ranges::find(lights_, light_id);
  const auto index = light_id == 0 ? 0 : static_cast<std::size_t>(found - lights_.begin()) + 1;
  assert(light_id == 0 || found != lights_.end());
  return seen_.data() + index * stride_;
}

void DisplayGaussians::gather_lights(const std::vector<std::uint32_t>& ids, std::size_t stride,
                                     device::Buffer<std::uint8_t>& to) {
  to.resize((1 + ids.size()) * stride);
  if (to.empty()) return;
  device::fill(stream_, to.data(), kAll, to.bytes());
  if (!lights_.empty()) device::copy(stream_, to.data(), seen_row(0), count_);
  for (std::size_t k = 0; k < ids.size(); ++k) {
    if (!std::ranges::binary_search(lights_, ids[k])) continue;
    device::copy(stream_, to.data() + (k + 1) * stride, seen_row(ids[k]), count_);
  }
}

void DisplayGaussians::apply(const DisplayLights& change) {
  device::Buffer<std::uint8_t> seen(stream_);
  if (!change.ids.empty()) gather_lights(change.ids, stride_, seen);
  stream_.wait();
  seen_ = std::move(seen);
  lights_ = change.ids;
}

void DisplayGaussians::apply(const DisplaySeen& change) {
  kernels::scatter(on_device(moved_bytes_, change.values), on_device(columns_, change.columns),
                   static_cast<std::uint32_t>(change.columns.size()), seen_row(change.light_id), stream_);
  stream_.wait();
}

void DisplayGaussians::apply(const DisplayRemoval& change) {
  const std::vector<std::uint32_t>& ascending = change.ascending;
  if (ascending.empty()) return;
  std::vector<std::uint32_t> order(count_ - ascending[0]);
  std::iota(order.begin(), order.end(), ascending[0]);
  std::vector<std::uint32_t> gone(ascending);
  for (std::uint32_t& i : gone) i -= ascending[0];
  remove_at(order, gone);
  gather(order, ascending[0]);
  count_ -= ascending.size();
}

void DisplayGaussians::gather(const std::vector<std::uint32_t>& order, std::size_t first) {
  if (order.empty()) return;
  const std::uint32_t* from = on_device(columns_, order);
  const auto count = static_cast<std::uint32_t>(order.size());
  moved_.resize(count);
  moved_ids_.resize(count);
  // Row by row, through one row's memory.
  for (int r = 0; r < row_count_; ++r) {
    kernels::gather(row(r), from, count, moved_.data(), stream_);
    device::copy(stream_, row(r) + first, moved_.data(), moved_.bytes());
  }
  kernels::gather(object_id_.data(), from, count, moved_ids_.data(), stream_);
  device::copy(stream_, object_id_.data() + first, moved_ids_.data(), moved_ids_.bytes());
  moved_bytes_.resize(count);
  for (std::size_t k = 0; !lights_.empty() && k <= lights_.size(); ++k) {
    std::uint8_t* bytes = seen_.data() + k * stride_;
    kernels::gather(bytes, from, count, moved_bytes_.data(), stream_);
    device::copy(stream_, bytes + first, moved_bytes_.data(), moved_bytes_.bytes());
  }
  stream_.wait();
}

GaussiansView DisplayGaussians::view() const {
  GaussiansView view;
  view.layout = layout_.parameters();
  view.count = count_;
  view.stride = stride_;
  view.parameters = rows_.data();
  view.object_id = object_id_.data();
  if (view.layout.appearance == Appearance::Transfer && !rows_.empty()) {
    view.normal = row(row_of(Attribute::Normal));
    view.visibility = row(row_of(Attribute::Visibility));
    if (!lights_.empty()) {
      view.visibility_u8 = seen_.data();
      view.visibility_stride = stride_;
      view.visibility_rows = static_cast<std::uint32_t>(1 + lights_.size());
    }
  }
  return view;
}

GaussiansView DisplayGaussians::view(const std::vector<LightSource>& sources) {
  std::vector<std::uint32_t> ids;
  for (const LightSource& source : sources) ids.push_back(source.id);
  GaussiansView out = view();
  if (ids == lights_ || out.visibility_u8 == nullptr) return out;
  gather_lights(ids, stride_, others_);
  stream_.wait();
  out.visibility_u8 = others_.data();
  out.visibility_rows = static_cast<std::uint32_t>(1 + ids.size());
  return out;
}

}  // namespace splatbus::stream
