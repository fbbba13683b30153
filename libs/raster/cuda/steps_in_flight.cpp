#include "raster/cuda/steps_in_flight.h"

namespace splatbus::raster::cuda {

using device::check;

StepsInFlight::StepsInFlight() {
  for (Entry& entry : entries_) {
    check(cudaEventCreateWithFlags(&entry.done, cudaEventDisableTiming), "making an event");
  }
}

StepsInFlight::~StepsInFlight() {
  for (Entry& entry : entries_) {
    if (entry.done != nullptr) cudaEventDestroy(entry.done);
  }
}

void StepsInFlight::push(const Step& step, const StepFigures* figures, cudaStream_t stream) {
  const std::size_t at = (first_ + count_) % kDepth;
  Entry& entry = entries_[at];
  entry.step = step;
  check(cudaMemcpyAsync(figures_.data() + at, figures, sizeof(StepFigures), cudaMemcpyDeviceToHost, stream),
        "reading a step's figures");
  check(cudaEventRecord(entry.done, stream), "recording an event");
  ++count_;
}

std::optional<StepsInFlight::Step> StepsInFlight::pop(bool wait) {
  if (count_ == 0) return std::nullopt;
  Entry& entry = entries_[first_];
  if (wait) {
    check(cudaEventSynchronize(entry.done), "waiting for a step");
  } else {
    const cudaError_t status = cudaEventQuery(entry.done);
    if (status == cudaErrorNotReady) return std::nullopt;
    check(status, "asking for a step");
  }
  Step step = entry.step;
  step.figures = figures_[first_];
  first_ = (first_ + 1) % kDepth;
  --count_;
  return step;
}

}  // namespace splatbus::raster::cuda
