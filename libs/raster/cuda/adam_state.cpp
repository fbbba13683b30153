#include "raster/cuda/adam_state.h"

#include <utility>

namespace splatbus::raster::cuda {

void AdamState::reset(const ParameterLayout& layout, int count, std::int64_t stride, cudaStream_t stream) {
  count_ = count;
  stride_ = stride;
  first_.reset(layout.channels(), count, stride, stream);
  second_.reset(layout.channels(), count, stride, stream);
  steps_.reset(1, count, stride, stream);
  gather_statistics(std::exchange(gathers_, false), stream);
}

void AdamState::resize(int count, std::int64_t stride, cudaStream_t stream) {
  const auto follow = [&](auto& planes) {
    if (stride == stride_) return planes.resize(count, stream);
    auto moved = planes.restrided(count, stride, stream);
    check(cudaStreamSynchronize(stream), "moving what training keeps");
    planes = std::move(moved);
  };
  follow(first_);
  follow(second_);
  follow(steps_);
  follow(mean2d_norm_);
  follow(mean2d_steps_);
  stride_ = stride;
  count_ = count;
}

void AdamState::move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream) {
  first_.move(from, to, count, stream);
  second_.move(from, to, count, stream);
  steps_.move(from, to, count, stream);
  mean2d_norm_.move(from, to, count, stream);
  mean2d_steps_.move(from, to, count, stream);
}

void AdamState::gather_statistics(bool gather, cudaStream_t stream) {
  if (gather == gathers_) return;
  ColumnPlanes<float> norm;
  ColumnPlanes<std::uint32_t> norm_steps;
  if (gather) {
    norm.reset(1, count_, stride_, stream);
    norm_steps.reset(1, count_, stride_, stream);
  }
  mean2d_norm_ = std::move(norm);
  mean2d_steps_ = std::move(norm_steps);
  gathers_ = gather;
}

void AdamState::clear_statistics(cudaStream_t stream) {
  mean2d_norm_.clear(stream);
  mean2d_steps_.clear(stream);
}

}  // namespace splatbus::raster::cuda
