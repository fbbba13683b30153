#include "stream/display_gaussians.h"

#include <algorithm>
#include <numeric>

namespace splatbus::stream {

namespace {

void restride(std::vector<float>& values, std::size_t planes, std::size_t count, std::size_t from, std::size_t to) {
  std::vector<float> grown(planes * to);
  for (std::size_t p = 0; p < planes; ++p) std::copy_n(values.data() + p * from, count, grown.data() + p * to);
  values = std::move(grown);
}

void close_gaps(float* plane, std::size_t count, std::span<const std::uint32_t> ascending) {
  std::size_t to = ascending[0], next = 0;
  for (std::size_t from = to; from < count; ++from) {
    if (next < ascending.size() && ascending[next] == from) {
      ++next;
    } else {
      plane[to++] = plane[from];
    }
  }
}

}  // namespace

void DisplayGaussians::reserve(std::size_t columns) {
  if (columns <= stride_) return;
  const std::size_t stride = std::max({columns, 2 * stride_, std::size_t{4096}});
  restride(parameters_, static_cast<std::size_t>(layout_.parameters().channels()), count_, stride_, stride);
  restride(normal_, 3, count_, stride_, stride);
  restride(visibility_, 1, count_, stride_, stride);
  stride_ = stride;
}

DequantizedChannels DisplayGaussians::planes() {
  return {parameters_.data(), normal_.data(), visibility_.data(), stride_};
}

void DisplayGaussians::extend(const QuantizedGaussians& gaussians) {
  const std::size_t first = count_;
  reserve(gaussians.count());
  count_ = gaussians.count();
  object_id_ = gaussians.object_id;
  std::vector<std::uint32_t> columns(count_ - first);
  std::iota(columns.begin(), columns.end(), static_cast<std::uint32_t>(first));
  for (const AttributeChannels& a : layout_.attributes()) update(gaussians, a.attribute, columns);
}

void DisplayGaussians::update(const QuantizedGaussians& gaussians, Attribute attribute,
                              std::span<const std::uint32_t> columns) {
  dequantize(gaussians, layout_, attribute, columns, planes());
}

void DisplayGaussians::update_objects(const QuantizedGaussians& gaussians, std::span<const std::uint32_t> columns) {
  for (const std::uint32_t i : columns) object_id_[i] = gaussians.object_id[i];
}

void DisplayGaussians::remove(std::span<const std::uint32_t> ascending) {
  if (ascending.empty()) return;
  for (int c = 0; c < layout_.parameters().channels(); ++c) {
    close_gaps(parameters_.data() + static_cast<std::size_t>(c) * stride_, count_, ascending);
  }
  for (std::size_t c = 0; c < 3; ++c) close_gaps(normal_.data() + c * stride_, count_, ascending);
  close_gaps(visibility_.data(), count_, ascending);
  remove_at(object_id_, ascending);
  count_ -= ascending.size();
}

void DisplayGaussians::reorder(std::span<const std::uint32_t> order) {
  std::vector<float> before(count_);
  const auto plane = [&](float* values) {
    std::copy_n(values, count_, before.begin());
    for (std::size_t i = 0; i < count_; ++i) values[i] = before[order[i]];
  };
  for (int c = 0; c < layout_.parameters().channels(); ++c) {
    plane(parameters_.data() + static_cast<std::size_t>(c) * stride_);
  }
  for (std::size_t c = 0; c < 3; ++c) plane(normal_.data() + c * stride_);
  plane(visibility_.data());
  const std::vector<std::uint32_t> objects = object_id_;
  for (std::size_t i = 0; i < count_; ++i) object_id_[i] = objects[order[i]];
}

GaussiansView DisplayGaussians::view() const {
  GaussiansView view;
  view.layout = layout_.parameters();
  view.count = count_;
  view.stride = stride_;
  view.parameters = parameters_.data();
  view.normal = normal_.data();
  view.visibility = visibility_.data();
  view.object_id = object_id_.data();
  return view;
}

}  // namespace splatbus::stream
