#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <span>
#include <tuple>
#include <utility>
#include <vector>

#include "raster/cuda/train_step.h"
#include "trainer/optimizer.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Training steps that are on their way on the device, and the views whose pictures they read: those are kept until the
/// device is done with them. Views of a step that differ in the size of their pictures, and more than
/// raster::cuda::kMaxBatch of them, are trained one part after the other. A part whose lists did not fit has changed
/// nothing and is trained again.
///
/// All on the stream of `train`, which outlives this. One thread. Throws std::runtime_error naming the CUDA error;
/// nothing reads the pictures of what could not be enqueued any more then.
class StepQueue {
 public:
  explicit StepQueue(raster::cuda::TrainStep& train) : train_(train) {}
  ~StepQueue();
  StepQueue(const StepQueue&) = delete;
  StepQueue& operator=(const StepQueue&) = delete;

  /// Enqueues a step of these views; their pictures lie in device memory. Returns how many.
  std::size_t enqueue(std::span<const TrainingViewPtr> views);
  /// Enqueues what is to be trained again.
  void enqueue_repeats();

  [[nodiscard]] bool empty() const { return parts_.empty(); }
  /// The figures of steps that have come to their end; of all of them, after waiting, with `wait`.
  [[nodiscard]] StepReport collect(bool wait);

 private:
  using Clock = std::chrono::steady_clock;
  using GroupKey = std::tuple<std::uint32_t, std::uint32_t, std::size_t>;  // width, height, views

  /// Views that are trained at once: a whole step, or one of several parts of it.
  struct Part {
    std::vector<TrainingViewPtr> views;
    bool ends_step = false;
    int tries = 0;  // that changed nothing, for its lists did not fit
  };

  static std::vector<Part> split(std::span<const TrainingViewPtr> views);
  /// Returns how many of its views are on their way.
  std::size_t enqueue(Part part);
  void give_up(const Part& part);
  std::size_t group_for(std::span<const raster::cuda::TrainView> views);
  void repeat(Part part);

  raster::cuda::TrainStep& train_;
  std::map<GroupKey, std::size_t> groups_;
  std::deque<Part> parts_;       // under way
  std::deque<Part> repeats_;     // whose lists did not fit
  std::size_t ended_steps_ = 0;  // not reported yet, whose last part was given up
  Clock::time_point busy_since_{};
  bool warned_lists_ = false;
};

}  // namespace splatbus::trainer
