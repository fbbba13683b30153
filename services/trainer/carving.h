#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "trainer/carving_kernels.h"
#include "trainer/per_index.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Finds the Gaussians that stand where pictures show free space. Work is enqueued on a stream, whose owner tells by
/// the number of a step what has been done. One thread.
class Carver {
 public:
  explicit Carver(device::StreamView stream);

  /// Judges the Gaussians by a view with depth, on the stream's device. `step`: the newest that is enqueued.
  void look(const TrainingViewPtr& view, const kernels::PagedGaussians& gaussians, const PageBounds* bounds,
            const kernels::CarveLimits& limits, std::uint64_t step);
  /// Those that had got enough votes before a step that is done; some may have lost them again.
  [[nodiscard]] std::size_t carvable(std::uint64_t done_step);
  /// Whether pictures are being looked at.
  [[nodiscard]] bool busy() const { return !looks_.empty(); }
  /// All that was enqueued on the stream is done.
  void settled();

  /// Marks them as mark_free(), and waits. Returns how many there are; carvable() counts anew.
  [[nodiscard]] std::size_t mark(const kernels::PagedGaussians& gaussians, std::uint32_t votes, std::uint8_t* dead);

  /// The model's structure has changed: there are `count` indices, those of `fresh` (on the device) begin anew, then
  /// what was kept of moves.from[k] is that of moves.to[k].
  void follow(std::size_t count, const device::Buffer<IndexRange>& fresh, const model::Moves& moves);

 private:
  /// What the device reads until it has looked.
  struct Look {
    std::uint64_t step = 0;
    TrainingViewPtr view;
    std::vector<kernels::CameraOfFrame> cameras;
    device::Buffer<kernels::CameraOfFrame> device_cameras;
  };
  void count_carvable();
  /// Of the engine frame, among the last kInstants of them.
  std::uint8_t instant_of(std::uint64_t frame);

  device::StreamView stream_;
  PerIndex<std::uint8_t> standing_;
  device::Buffer<std::uint32_t> counts_;  ///< that ever became carvable; that were marked
  std::deque<Look> looks_;
  std::vector<std::uint64_t> frames_;  ///< of instants 1 and up
  std::size_t oldest_frame_ = 0;
  std::uint32_t counted_ = 0, carved_ = 0;  ///< of those that ever became carvable
};

}  // namespace splatbus::trainer
