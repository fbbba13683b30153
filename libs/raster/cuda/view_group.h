#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "raster/cuda/graph.h"
#include "raster/cuda/staging.h"
#include "raster/cuda/steps_in_flight.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::cuda {

/// Which pictures beside the lit one any view of a group has to be compared with.
struct Targets {
  bool albedo = false, depth = false;

  Targets() = default;
  explicit Targets(std::span<const TrainView> views);
  auto operator<=>(const Targets&) const = default;
};

/// Views that are trained together: their tables and tile lists on the device, and how large the lists are.
class ViewGroup {
 public:
  /// Throws std::invalid_argument unless there are 1 to kMaxBatch views of one size.
  explicit ViewGroup(std::span<const TrainView> views);

  /// Copies the views' tables to the device. Lists made for other views no longer count, nor what they hid.
  void set_views(std::span<const TrainView> views, Appearance appearance, bool use_depth_limit, Staging& staging,
                 cudaStream_t stream);
  /// Makes the slots of objects, and the arrays of a Gaussian each, as the model is now.
  void follow_model(const DeviceGaussians& gaussians, Staging& staging, cudaStream_t stream);
  /// The model's structure has changed, from `count_before` Gaussians.
  void model_changed(int count, int count_before);
  void invalidate_graphs();

  /// Points the workspace at this group's tables and lists; `entries_` too when it keeps them.
  void bind(WorkspaceView& w) const;

  [[nodiscard]] const StepFigures* figures() const { return figures_.data(); }
  [[nodiscard]] const std::uint8_t* const* color_targets() const { return at<const std::uint8_t*>(color_offset_); }
  [[nodiscard]] const std::uint8_t* const* albedo_targets() const { return at<const std::uint8_t*>(albedo_offset_); }
  [[nodiscard]] const float* const* depth_targets() const { return at<const float*>(depth_offset_); }
  [[nodiscard]] const Targets& targets() const { return targets_; }

  /// Takes note of how many pairs a build wanted.
  void note_pairs(std::uint32_t pairs);
  /// Sizes the lists by a build that was waited for.
  void size_by(std::uint32_t pairs);
  /// What its lists take is not to be had: they are sized anew, for other views perhaps.
  void forget_size();
  /// Makes room for entries of its own, which reads of four at a time may overrun. Waits when it has to grow.
  void keep_entries(cudaStream_t stream);

  [[nodiscard]] std::size_t bytes() const;

  const int batch, width, height;
  static constexpr std::uint32_t kFirstPairs = 1U << 20U;  ///< before they are counted
  std::uint32_t pair_capacity = kFirstPairs;
  bool sized = false;    ///< pair_capacity comes from these views' own pairs
  bool renewed = false;  ///< its views change, and with them their pairs
  int steps = 0;         ///< since the lists were built
  bool lists_built = false;
  Graph rebuild_graph, reuse_graph;

 private:
  template <class T>
  [[nodiscard]] T* at(std::size_t offset) const {
    return reinterpret_cast<T*>(tables_.data() + offset);
  }
  void choose_objects(std::span<const SceneView> views);
  void set_capacity(std::uint32_t pairs);

  // One table, copied at once: views, targets of colour, albedo and depth, views of objects.
  std::vector<std::byte> host_tables_;
  device::Buffer<std::byte> tables_;
  std::size_t color_offset_ = 0, albedo_offset_ = 0, depth_offset_ = 0, object_offset_ = 0;
  Targets targets_;

  std::vector<std::uint32_t> object_ids_;
  device::Buffer<std::uint32_t> device_object_ids_;
  device::Buffer<std::uint16_t> object_slot_;
  bool slots_stale_ = true, slotted_ = false;

  device::Buffer<uint2> tile_range_;
  device::Buffer<float> patch_depth_limit_;
  device::Buffer<std::uint32_t> entries_;
  device::Buffer<std::uint16_t> listed_;
  device::Buffer<StepFigures> figures_{1};
  std::uint32_t most_pairs_ = 0;  // of the last builds
  int builds_ = 0;
  bool keeps_entries_ = false;
};

}  // namespace splatbus::raster::cuda
