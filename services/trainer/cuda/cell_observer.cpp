#include "trainer/cuda/cell_observer.h"

#include "raster/cuda/kernels.h"

namespace splatbus::trainer {

using device::check;

CellObserver::CellObserver() {
  check(cudaEventCreateWithFlags(&done_, cudaEventDisableTiming), "making an event");
}

CellObserver::~CellObserver() {
  cudaEventDestroy(done_);
}

bool CellObserver::due() {
  return ++steps_ >= (stale_ ? kStaleInterval : kInterval) && !under_way_;
}

void CellObserver::reserve(std::size_t columns) {
  if (columns <= contribution_.size()) return;
  sorted_.resize(columns);
  ids_.resize(columns);
  gaussians_.resize(columns);
  sums_.resize(columns);
  std::size_t bytes = 0;
  cuda::list_cells(nullptr, columns, sorted_.data(), {ids_.data(), gaussians_.data(), cell_count_.data()}, nullptr,
                   bytes, nullptr);
  scratch_.resize(bytes);
  contribution_.resize(columns);  // last: its size says that there is room for all
}

void CellObserver::list(const std::uint64_t* cell, std::size_t count, cudaStream_t stream) {
  std::size_t bytes = scratch_.size();
  cuda::list_cells(cell, count, sorted_.data(), {ids_.data(), gaussians_.data(), cell_count_.data()}, scratch_.data(),
                   bytes, stream);
  most_cells_ = count;
  stale_ = false;
  recounted_ = true;
}

void CellObserver::observe(const raster::cuda::DeviceGaussians& gaussians, const cuda::Columns& columns,
                           const std::uint64_t* cell, cuda::ObservedView observed, cudaStream_t stream) {
  reserve(static_cast<std::size_t>(columns.stride));
  if (stale_) list(cell, static_cast<std::size_t>(columns.count), stream);
  check(cudaMemsetAsync(sums_.data(), 0, most_cells_ * sizeof(cuda::CellSums), stream), "clearing cells' sums");
  check(cudaMemsetAsync(contribution_.data(), 0, static_cast<std::size_t>(columns.count) * sizeof(float), stream),
        "clearing contributions");
  raster::cuda::launch_contribution(gaussians, observed.workspace, observed.view, contribution_.data(), stream);
  observed.contribution = contribution_.data();
  observed.min_contribution = CellSampler::kMinContribution;
  cuda::launch_cell_samples(columns, cell, observed, {ids_.data(), gaussians_.data(), cell_count_.data()}, sums_.data(),
                            stream);
  check(cudaMemcpyAsync(host_cell_count_.data(), cell_count_.data(), sizeof(std::uint32_t), cudaMemcpyDeviceToHost,
                        stream),
        "reading the number of cells");
  check(cudaEventRecord(done_, stream), "recording an event");
  under_way_ = true;
  steps_ = 0;
}

void CellObserver::collect(bool wait, CellTable& cells) {
  if (!under_way_) return;
  if (!wait) {
    const cudaError_t status = cudaEventQuery(done_);
    if (status == cudaErrorNotReady) return;
    check(status, "asking for cells");
  }
  check(cudaEventSynchronize(done_), "waiting for cells");
  under_way_ = false;
  const std::size_t count = host_cell_count_[0];
  host_ids_.resize(count);
  host_gaussians_.resize(count);
  host_sums_.resize(count);
  // On a stream of its own: the steps given meanwhile are not waited for.
  ids_.download(host_ids_.data(), count, copies_.get());
  gaussians_.download(host_gaussians_.data(), count, copies_.get());
  sums_.download(host_sums_.data(), count, copies_.get());
  copies_.wait();
  if (recounted_) cells.recount(host_ids_, host_gaussians_);
  recounted_ = false;
  for (std::size_t k = 0; k < count; ++k) {
    const cuda::CellSums& sums = host_sums_[k];
    if (sums.samples == 0) continue;
    const auto samples = static_cast<float>(sums.samples);
    cells.observe(host_ids_[k], sums.samples, sums.loss / samples, sums.movement / samples);
  }
}

}  // namespace splatbus::trainer
