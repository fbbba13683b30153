#include "stream/display_gaussians.h"

#include <algorithm>
#include <numeric>

#include "stream/channel_kernels.h"

namespace splatbus::stream {

namespace {

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
      moved_(stream),
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
  rows_ = std::move(rows);
  object_id_ = std::move(object_id);
  stride_ = stride;
}

void DisplayGaussians::extend(const QuantizedGaussians& gaussians) {
  const std::size_t first = count_;
  reserve(gaussians.count());
  count_ = gaussians.count();
  std::vector<std::uint32_t> columns(count_ - first);
  std::iota(columns.begin(), columns.end(), static_cast<std::uint32_t>(first));
  update_objects(gaussians, columns);
  for (const AttributeChannels& a : layout_.attributes()) update(gaussians, a.attribute, columns);
}

void DisplayGaussians::update(const QuantizedGaussians& gaussians, Attribute attribute,
                              std::span<const std::uint32_t> columns) {
  const AttributeChannels& a = layout_.at(attribute);
  std::vector<std::int32_t> values;
  values.reserve(static_cast<std::size_t>(a.channels) * columns.size());
  for (int c = a.first; c < a.first + a.channels; ++c) {
    for (const std::uint32_t i : columns) values.push_back(gaussians.channels[c][i]);
  }
  const std::vector<std::uint32_t> where(columns.begin(), columns.end());
  kernels::dequantize({.offset = a.quantizer.offset,
                       .step = a.quantizer.step,
                       .kind = coding_of(attribute),
                       .channels = a.channels,
                       .row = row_of(attribute)},
                      on_device(values_, values), on_device(columns_, where), static_cast<std::uint32_t>(where.size()),
                      rows_.data(), stride_, stream_);
  stream_.wait();
}

void DisplayGaussians::update_objects(const QuantizedGaussians& gaussians, std::span<const std::uint32_t> columns) {
  std::vector<std::uint32_t> values;
  values.reserve(columns.size());
  for (const std::uint32_t i : columns) values.push_back(gaussians.object_id[i]);
  const std::vector<std::uint32_t> where(columns.begin(), columns.end());
  kernels::scatter(on_device(moved_ids_, values), on_device(columns_, where), static_cast<std::uint32_t>(where.size()),
                   object_id_.data(), stream_);
  stream_.wait();
}

void DisplayGaussians::remove(std::span<const std::uint32_t> ascending) {
  if (ascending.empty()) return;
  std::vector<std::uint32_t> order(count_ - ascending[0]);
  std::iota(order.begin(), order.end(), ascending[0]);
  std::vector<std::uint32_t> gone(ascending.begin(), ascending.end());
  for (std::uint32_t& i : gone) i -= ascending[0];
  remove_at(order, gone);
  gather(order, ascending[0]);
  count_ -= ascending.size();
}

void DisplayGaussians::gather(std::span<const std::uint32_t> order, std::size_t first) {
  if (order.empty()) return;
  const std::vector<std::uint32_t> host(order.begin(), order.end());
  const std::uint32_t* from = on_device(columns_, host);
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
  }
  return view;
}

}  // namespace splatbus::stream
