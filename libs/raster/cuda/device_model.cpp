#include "raster/cuda/device_model.h"

#include <algorithm>

#include "device/check.h"

namespace splatbus::raster::cuda {
namespace {

using device::check;

/// Rows of `width` elements, `from_pitch` elements apart, to rows that lie `width` apart.
template <class T>
T* upload_rows(device::Buffer<T>& to, const T* from, std::size_t rows, std::size_t width, std::size_t from_pitch,
               cudaStream_t stream) {
  if (from == nullptr) return nullptr;
  to.resize(rows * width);
  if (rows * width == 0) return to.data();
  check(cudaMemcpy2DAsync(to.data(), width * sizeof(T), from, from_pitch * sizeof(T), width * sizeof(T), rows,
                          cudaMemcpyHostToDevice, stream),
        "copying a model to the device");
  return to.data();
}

}  // namespace

void DeviceRanges::upload(const GaussiansView& host, cudaStream_t stream) {
  ranges_.upload(host.ranges.data(), host.ranges.size(), stream);
  bounds_.upload(host.bounds.data(), host.bounds.size(), stream);
}

void DeviceRanges::bind(DeviceGaussians& gaussians) const {
  gaussians.ranges = ranges_.data();
  gaussians.bounds = bounds_.empty() ? nullptr : bounds_.data();
  gaussians.range_count = static_cast<int>(ranges_.size());
}

DeviceGaussians device_gaussians(const GaussiansView& view) {
  return {.layout = view.layout,
          .count = static_cast<int>(view.count),
          .stride = static_cast<std::int64_t>(view.stride),
          .page_shift = view.page_shift,
          .page_stride = static_cast<std::int64_t>(view.page_stride),
          .parameters = const_cast<float*>(view.parameters),  // written by training only
          .normal = view.normal,
          .visibility = view.visibility,
          .visibility_u8 = view.visibility_u8,
          .visibility_stride = view.visibility_stride,
          .visibility_rows = view.visibility_rows,
          .object_id = view.object_id,
          .flags = view.flags};
}

void DeviceModel::upload(const GaussiansView& host, cudaStream_t stream) {
  view_ = device_gaussians(host);
  if (host.has_pages()) {
    upload_pages(host, stream);
  } else {
    upload_planes(host, stream);
  }
  view_.visibility_u8 = upload_rows(visibility_u8_, host.visibility_u8, host.visibility_rows, host.count,
                                    std::max(host.visibility_stride, host.count), stream);
  view_.visibility_stride = host.count;
  ranges_.upload(host, stream);
  ranges_.bind(view_);
}

void DeviceModel::upload_planes(const GaussiansView& host, cudaStream_t stream) {
  const auto copy = [&](auto& to, const auto* from, std::size_t planes) {
    return upload_rows(to, from, planes, host.count, host.stride, stream);
  };
  view_.stride = view_.count;
  view_.parameters = copy(parameters_, host.parameters, static_cast<std::size_t>(host.layout.channels()));
  view_.normal = copy(normal_, host.normal, 3);
  view_.visibility = copy(visibility_, host.visibility, 1);
  view_.object_id = copy(object_id_, host.object_id, 1);
  view_.flags = copy(flags_, host.flags, 1);
}

/// All channels of a page lie in one block.
void DeviceModel::upload_pages(const GaussiansView& host, cudaStream_t stream) {
  const std::size_t lanes = std::size_t{1} << host.page_shift, pages = (host.count + lanes - 1) / lanes;
  const auto channels = static_cast<std::size_t>(host.layout.channels());
  const auto rows_if = [](const auto* from, std::size_t rows) { return from != nullptr ? rows : 0; };
  const std::size_t rows = channels + rows_if(host.normal, 3) + rows_if(host.visibility, 1) +
                           rows_if(host.object_id, 1) + rows_if(host.flags, 1);
  parameters_.resize(pages * rows * lanes);
  view_.page_stride = static_cast<std::int64_t>(rows * lanes);
  std::size_t row = 0;
  const auto copy = [&]<class T>(const T* from, std::size_t planes) -> T* {
    if (from == nullptr || pages == 0) return nullptr;
    float* const to = parameters_.data() + row * lanes;
    row += planes;
    check(cudaMemcpy2DAsync(to, rows * lanes * sizeof(T), from, host.page_stride * sizeof(T),
                            planes * lanes * sizeof(T), pages, cudaMemcpyHostToDevice, stream),
          "copying a model to the device");
    return reinterpret_cast<T*>(to);
  };
  view_.parameters = copy(host.parameters, channels);
  view_.normal = copy(host.normal, 3);
  view_.visibility = copy(host.visibility, 1);
  view_.object_id = copy(host.object_id, 1);
  view_.flags = copy(host.flags, 1);
}

void DeviceModel::download_parameters(float* host, cudaStream_t stream) const {
  const auto channels = static_cast<std::size_t>(view_.layout.channels());
  if (!view_.has_pages()) return parameters_.download(host, channels * static_cast<std::size_t>(view_.count), stream);
  const std::size_t lanes = std::size_t{1} << view_.page_shift;
  const std::size_t pages = (static_cast<std::size_t>(view_.count) + lanes - 1) / lanes;
  const std::size_t width = channels * lanes * sizeof(float);
  check(cudaMemcpy2DAsync(host, width, view_.parameters, static_cast<std::size_t>(view_.page_stride) * sizeof(float),
                          width, pages, cudaMemcpyDeviceToHost, stream),
        "copying a model's parameters");
}

}  // namespace splatbus::raster::cuda
