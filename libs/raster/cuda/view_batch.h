#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "device/pinned.h"
#include "raster/cuda/graph.h"
#include "raster/cuda/view_tables.h"
#include "raster/cuda/workspace.h"

namespace splatbus::raster::cuda {

/// A view to train on: camera, scene and pictures on the device (u8 RGBA; depth float). All of it must stay as it is
/// until the step is done, which `keep` can see to.
struct TrainView {
  SceneView view;
  const std::uint8_t* color = nullptr;
  const std::uint8_t* albedo = nullptr;  ///< null: this view has no albedo loss
  const float* depth = nullptr;          ///< metres along z, 0 where there is no surface; null: no depth loss, no mask
                                         ///< of what nothing models, no sky told from surfaces
  const std::uint8_t* mask = nullptr;    ///< [h][w], as in raster::LossOptions; null: none
  std::shared_ptr<const void> keep = nullptr;  ///< owner of the scene and the pictures, held until the step is done
};

/// Which pictures beside the lit one any view has to be compared with.
struct Targets {
  bool albedo = false, depth = false, mask = false;

  Targets() = default;
  explicit Targets(std::span<const TrainView> views);
  bool operator==(const Targets&) const = default;
};

/// What all steps on one number of views of one size share: the tables on the device, how many intersections there is
/// room for, and the step as a graph. Not thread-safe. Throws std::runtime_error naming the CUDA error.
class ViewBatch {
 public:
  /// Steps that may be on their way at once.
  static constexpr int kStepsInFlight = 3;

  ViewBatch(int views, int pixel_columns, int pixel_rows) : batch(views), width(pixel_columns), height(pixel_rows) {}

  /// Writes the tables that the next copy_tables() takes, where no step on its way reads them. Waits for the stream
  /// when more objects move than before.
  /// `loss_limits`: of each view, as in AdamOptions.
  void set_views(std::span<const TrainView> views, std::span<const float> loss_limits, Appearance appearance,
                 cudaStream_t stream);
  /// The first stage of a step, the same for all of them: takes the tables and clears the counts.
  void copy_tables(StepCounts* counts, cudaStream_t stream) const;
  /// Finds each Gaussian's object again where the model or the objects have changed.
  void follow_model(const DeviceGaussians& gaussians, cudaStream_t stream);
  /// The model's structure has changed, from `count_before` Gaussians.
  void model_changed(int count, int count_before);
  /// Points the workspace at these tables.
  void bind(WorkspaceView& w) const;

  [[nodiscard]] const std::uint8_t* const* color_targets() const { return at<const std::uint8_t*>(color_offset_); }
  [[nodiscard]] const std::uint8_t* const* albedo_targets() const { return at<const std::uint8_t*>(albedo_offset_); }
  [[nodiscard]] const float* const* depth_targets() const { return at<const float*>(depth_offset_); }
  /// Null when no view has a mask.
  [[nodiscard]] const std::uint8_t* const* masks() const {
    return targets_.mask ? at<const std::uint8_t*>(mask_offset_) : nullptr;
  }
  [[nodiscard]] const float* loss_limits() const { return at<float>(limit_offset_); }
  [[nodiscard]] const Targets& targets() const { return targets_; }

  /// How many intersections a step found, and ranges that its views see. Throws when there are more of the former than
  /// can be sorted.
  void note_lists(std::uint32_t isects, std::uint32_t ranges);
  /// Makes room for those of a projection that was waited for.
  void size_by(std::uint32_t isects, std::uint32_t ranges);
  [[nodiscard]] bool sized() const { return sized_; }
  [[nodiscard]] std::uint32_t isect_capacity() const { return isect_capacity_; }
  /// Whether any view has, or lately had, a far field.
  [[nodiscard]] bool has_far_field() const;
  [[nodiscard]] std::uint32_t list_capacity() const { return list_capacity_; }

  [[nodiscard]] std::size_t bytes() const;  ///< of device memory

  const int batch, width, height;
  Graph graph;

 private:
  template <class T>
  [[nodiscard]] T* at(std::size_t offset) const {
    return reinterpret_cast<T*>(tables_.data() + offset);
  }
  void choose_objects(std::span<const SceneView> views);
  void choose_source_room(int needed);
  void lay_out_tables(cudaStream_t stream);
  void set_capacity(std::uint32_t isects);
  void set_list_capacity(std::uint32_t ranges);

  // One table: views, targets of colour, albedo and depth, masks, limits of losses, views of objects, light sources.
  // The host fills a ring of them.
  static constexpr int kSlots = kStepsInFlight + 1;
  std::size_t color_offset_ = 0, albedo_offset_ = 0, depth_offset_ = 0, mask_offset_ = 0;
  std::size_t limit_offset_ = 0, object_offset_ = 0, source_offset_ = 0, table_bytes_ = 0;
  device::Pinned<std::byte> ring_;
  device::Buffer<std::byte> tables_;
  device::Buffer<std::uint32_t> device_turn_{1};
  std::uint32_t turn_ = 0;  // tables written
  Targets targets_;

  std::vector<std::uint32_t> object_ids_;
  device::Buffer<std::uint32_t> device_object_ids_;
  device::Buffer<std::uint16_t> object_slot_;
  bool slots_stale_ = true, slotted_ = false;

  int source_room_ = 0;  // a view
  int steps_without_sources_ = 0;

  std::uint32_t isect_capacity_ = 1U << 20U, list_capacity_ = 64;
  bool sized_ = false;                             // by views' own intersections
  std::uint32_t max_isects_ = 0, max_ranges_ = 0;  // of the last steps
  int steps_ = 0;                                  // that they are the maximum of
};

}  // namespace splatbus::raster::cuda
