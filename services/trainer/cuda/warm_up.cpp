#include "trainer/cuda/warm_up.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <mutex>
#include <vector>

#include "gaussians/model.h"
#include "raster/cuda/device_model.h"
#include "raster/cuda/train_step.h"
#include "trainer/cuda/prune_check.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kGaussians = 1 << 13;  // as many pairs as make the sort work as it does on more
constexpr std::uint32_t kSize = 64;

/// A square of small opaque Gaussians before the camera.
GaussiansBuffer square(const ParameterLayout& layout) {
  GaussiansBuffer model(layout, kGaussians);
  constexpr std::size_t kSide = 91;
  for (std::size_t i = 0; i < kGaussians; ++i) {
    const std::size_t row = i / kSide;
    const auto put = [&](int channel, float value) {
      model.parameters[static_cast<std::size_t>(channel) * model.stride() + i] = value;
    };
    put(ParameterLayout::kMean, static_cast<float>(i % kSide) / kSide - 0.5F);
    put(ParameterLayout::kMean + 1, static_cast<float>(row) / kSide - 0.5F);
    for (int k = 0; k < 3; ++k) put(ParameterLayout::kLogScale + k, -4.0F);
    put(ParameterLayout::kRotation, 1.0F);
    put(ParameterLayout::kOpacityLogit, 6.0F);  // a pixel is done after a few of them
  }
  return model;
}

void run_kernels(const ParameterLayout& layout) {
  const GaussiansBuffer host = square(layout);
  raster::cuda::DeviceModel model, average;
  const SceneState scene;
  const Camera camera = look_at({0, 0, 2}, {0, 0, 0}, kSize, kSize, 1.0F);
  const device::Buffer<std::uint8_t> picture(std::size_t{4} * kSize * kSize);
  device::Buffer<std::uint64_t> birth(kGaussians);
  for (const bool albedo : {true, false}) {
    raster::cuda::TrainStep train({.albedo_weight = 1.0F, .unit_albedo = true});
    cudaStream_t stream = train.stream();
    birth.clear(stream);
    model.upload(host.view(), stream);
    average.upload(host.view(), stream);
    device::check(cudaStreamSynchronize(stream), "warming up");
    train.set_model(model.view());
    train.set_learning_rates(std::vector<float>(static_cast<std::size_t>(layout.channels()), 0.0F));
    const raster::cuda::TrainView view{.view = {.camera = camera, .scene = &scene},
                                       .color = picture.data(),
                                       .albedo = albedo ? picture.data() : nullptr};
    const std::size_t group = train.add_group({&view, 1});
    for (int k = 0; k < 2; ++k) train.step(group);  // sized and captured, then launched again

    const cuda::Columns columns{.count = model.view().count,
                                .stride = model.view().stride,
                                .parameters = model.view().parameters,
                                .average = average.view().parameters,
                                .flags = model.view().flags,
                                .birth = birth.data(),
                                .active_channels = layout.channels()};
    cuda::launch_average(columns, {.begin = 0, .end = columns.count, .step = 1, .settled_share = 1, .stripes = 1},
                         stream);
    PruneCheck pruning(stream);
    pruning.search(columns, {.max_scale_m = 1.0F}, 1);
    device::check(cudaStreamSynchronize(stream), "warming up");
  }
}

}  // namespace

void warm_up(const ParameterLayout& layout) {
  static std::mutex mutex;
  static std::vector<ParameterLayout> warm;
  const std::scoped_lock lock(mutex);
  if (std::find(warm.begin(), warm.end(), layout) != warm.end()) return;
  run_kernels(layout);
  warm.push_back(layout);
}

}  // namespace splatbus::trainer
