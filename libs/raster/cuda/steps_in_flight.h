#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "device/pinned.h"
#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

/// What a step leaves on the device for the host to read once it is done: the loss of each view, and how many pairs its
/// lists were to hold.
struct StepFigures {
  float loss[kMaxBatch];
  std::uint32_t pairs;
};

/// The steps that were enqueued and are not known to be done: a short queue, so that a host that enqueues faster than
/// the device works waits here. Not thread-safe. Throws std::runtime_error naming the CUDA error.
class StepsInFlight {
 public:
  struct Step {
    std::size_t group = 0;
    std::uint32_t pair_capacity = 0;  ///< that its lists were built in
    bool training = false;
    StepFigures figures{};
  };

  StepsInFlight();
  ~StepsInFlight();
  StepsInFlight(const StepsInFlight&) = delete;
  StepsInFlight& operator=(const StepsInFlight&) = delete;

  [[nodiscard]] bool full() const { return count_ == kDepth; }
  [[nodiscard]] bool empty() const { return count_ == 0; }
  /// The step that `stream` has been given; `figures` on the device are fetched when it is done. Not when full.
  void push(const Step& step, const StepFigures* figures, cudaStream_t stream);
  /// The oldest step, when it is done or after waiting for it.
  [[nodiscard]] std::optional<Step> pop(bool wait);

 private:
  static constexpr std::size_t kDepth = 3;
  struct Entry {
    cudaEvent_t done = nullptr;
    Step step;
  };
  std::array<Entry, kDepth> entries_;
  device::Pinned<StepFigures> figures_{kDepth};
  std::size_t first_ = 0, count_ = 0;
};

}  // namespace splatbus::raster::cuda
