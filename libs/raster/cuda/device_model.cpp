#include "raster/cuda/device_model.h"

#include "device/check.h"

namespace splatbus::raster::cuda {
namespace {

template <class T>
void upload_planes(device::Buffer<T>& to, const T* from, std::size_t planes, std::size_t count, std::size_t stride,
                   cudaStream_t stream) {
  if (from == nullptr || count == 0) return;
  to.resize(planes * count);
  device::check(cudaMemcpy2DAsync(to.data(), count * sizeof(T), from, stride * sizeof(T), count * sizeof(T), planes,
                                  cudaMemcpyHostToDevice, stream),
                "copying a model to the device");
}

}  // namespace

void DeviceModel::upload(const GaussiansView& host, cudaStream_t stream) {
  const std::size_t n = host.count;
  upload_planes(parameters_, host.parameters, static_cast<std::size_t>(host.layout.channels()), n, host.stride, stream);
  upload_planes(normal_, host.normal, 3, n, host.stride, stream);
  upload_planes(visibility_, host.visibility, 1, n, host.stride, stream);
  upload_planes(object_id_, host.object_id, 1, n, host.stride, stream);
  upload_planes(flags_, host.flags, 1, n, host.stride, stream);
  view_ = {.layout = host.layout,
           .count = static_cast<int>(n),
           .stride = static_cast<std::int64_t>(n),
           .parameters = parameters_.data(),
           .normal = host.normal != nullptr ? normal_.data() : nullptr,
           .visibility = host.visibility != nullptr ? visibility_.data() : nullptr,
           .object_id = host.object_id != nullptr ? object_id_.data() : nullptr,
           .flags = host.flags != nullptr ? flags_.data() : nullptr};
}

void DeviceModel::download_parameters(float* host, cudaStream_t stream) const {
  parameters_.download(host, static_cast<std::size_t>(view_.layout.channels()) * static_cast<std::size_t>(view_.count),
                       stream);
}

}  // namespace splatbus::raster::cuda
