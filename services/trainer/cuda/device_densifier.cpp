#include "trainer/cuda/device_densifier.h"

#include <cmath>

#include "trainer/cuda/densify_kernels.h"
#include "trainer/cuda/device_columns.h"
#include "trainer/density.h"

namespace splatbus::trainer {

using device::check;

namespace {

/// Far apart for neighbouring steps (Fibonacci hashing).
std::uint32_t seed_of(std::uint64_t seed, std::uint64_t step) {
  return static_cast<std::uint32_t>(((seed << 32U) + step + 1) * 0x9E3779B97F4A7C15U >> 32U);
}

}  // namespace

std::vector<std::uint32_t> DeviceDensifier::choose(const ModelStore& store,
                                                   const raster::cuda::ScreenStatistics& statistics,
                                                   float gradient_threshold) {
  const auto count = static_cast<std::uint32_t>(store.count());
  if (count == 0 || statistics.steps == nullptr) return {};
  chosen_.resize(count);
  columns_.resize(count);
  scratch_.resize(cuda::list_columns_scratch_bytes(count));
  cuda::launch_choose_dense(store.planes(), statistics, count, gradient_threshold, chosen_.data(), stream_);
  cuda::launch_list_columns(chosen_.data(), true, 0, count, columns_.data(), listed_.data(), scratch_.data(),
                            scratch_.size(), stream_);
  listed_.download(host_listed_.data(), 1, stream_);
  check(cudaStreamSynchronize(stream_), "choosing Gaussians to clone");
  std::vector<std::uint32_t> columns(host_listed_[0]);
  columns_.download(columns.data(), columns.size(), stream_);
  check(cudaStreamSynchronize(stream_), "choosing Gaussians to clone");
  return columns;
}

ModelStore::Columns DeviceDensifier::densify(ModelStore& store, const std::vector<std::uint32_t>& columns,
                                             const DensifyOptions& options) {
  const ModelStore::Columns added = store.duplicate(columns);
  columns_.upload(columns.data(), columns.size(), stream_);
  // The planes may have moved.
  cuda::launch_split(store.planes(), columns_.data(), static_cast<std::uint32_t>(added.first),
                     static_cast<std::uint32_t>(added.count),
                     {.max_clone_log_scale = std::log(options.clone_max_scale_m),
                      .log_split_factor = std::log(kSplitFactor),
                      .seed = seed_of(seed_, store.step())},
                     stream_);
  check(cudaStreamSynchronize(stream_), "splitting Gaussians");
  return added;
}

}  // namespace splatbus::trainer
