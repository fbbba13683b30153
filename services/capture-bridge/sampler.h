#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "capture-bridge/covisibility.h"
#include "capture-bridge/input_view.h"
#include "capture-bridge/stages.h"
#include "device/buffer.h"
#include "device/stream.h"

namespace splatbus::capture_bridge {

/// Why pixels of an engine's frame were not taken as samples.
struct DropCounts {
  std::size_t not_finite = 0;  ///< position or normal is NaN or infinite
  std::size_t bad_normal = 0;  ///< not of unit length
  std::size_t off_ray = 0;     ///< the position does not project to its own pixel, or lies outside near and far

  [[nodiscard]] std::size_t broken() const { return not_finite + bad_normal + off_ray; }
  DropCounts& operator+=(const DropCounts& other);
  bool operator==(const DropCounts&) const = default;
  [[nodiscard]] std::string text() const;
};

/// Of a view, from the counts of its PixelFaults.
[[nodiscard]] DropCounts dropped_of(std::span<const std::uint32_t, kFaults> faults);

struct SamplingOptions {
  float min_cosine = 0.15F;  ///< between the normal and the direction to the camera
  CullOptions culling{};
  std::size_t budget = 60000;  ///< samples a round
  /// How many cameras keep their samples of the same surface, the best ones; 0: as many as the budget has room for.
  int cameras_per_surface = 0;
};

/// How many samples a round had, and what became of them.
struct RoundCounts {
  std::vector<DropCounts> dropped;  ///< a view
  int cameras_per_surface = 0;      ///< what the budget had room for
  std::size_t valid = 0;            ///< samples before culling
  std::size_t culled = 0;           ///< samples that another camera sees better
  std::size_t thinned = 0;          ///< samples over the budget
};

/// Sets cameras_per_surface, valid and culled of a round of whose pixels of_rank[r] have rank r; returns how many
/// samples survive culling. A surface gets as many cameras as the budget, or an eighth more, has room for: thinning
/// evens out what several cameras' grids leave, but a single camera's grid is more even than anything thinned.
std::size_t select_by_budget(std::span<const std::uint32_t, kRanks> of_rank, const SamplingOptions& options,
                             RoundCounts& counts);

/// What a round of input views comes to, as arrays in one kind of memory, written to the end. Meanings and shapes:
/// Samples in stages.h; position and normal are in the round's frame.
struct RoundSamples : RoundCounts {
  Device memory = Device::Cpu;
  std::size_t size = 0;
  const float *position = nullptr, *normal = nullptr, *albedo = nullptr, *color = nullptr;
  const float* spacing_m = nullptr;
  const std::uint32_t *object_id = nullptr, *pixel = nullptr;
  const float* depth_m = nullptr;  ///< of all views' pixels, along each camera's z, 0 where there is no surface
};

/// Turns rounds of input views into samples; one thread at a time. Its memory, and that of its views, is the device's.
/// All devices give the same samples in the same order.
class Sampler {
 public:
  /// Throws std::runtime_error when the device cannot be had.
  explicit Sampler(Device device);

  /// Validity and footprint, culling across cameras, budget, spacing. `views` are of one size; `round_objects` are the
  /// transforms of the round's frame, to which samples of moving objects are brought. The arrays hold until the next
  /// call. Throws std::runtime_error, also when there are more than kMaxViews views or 2^30 pixels.
  [[nodiscard]] RoundSamples sample(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options);

  /// The first half of it: the views' pixels, measured and ranked. They hold until the next call.
  [[nodiscard]] RoundPixels measure(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options);

 private:
  RoundPixels upload(Views views, const ObjectTransforms& round_objects);
  Candidates make_candidates(std::size_t count);
  Samples make_samples(std::size_t count);

  device::Stream stream_;
  device::Buffer<PixelView> views_;
  device::Buffer<MovedObject> moved_;
  device::Buffer<float> depth_m_, cosine_;
  device::Buffer<Surfel> surfels_;
  device::Buffer<bool> edges_;
  device::Buffer<SurfaceRank> ranks_;
  device::Buffer<RoundTally> tally_;
  device::Buffer<LinearTable> linear_;
  device::Buffer<std::uint32_t> candidate_pixel_, kept_;
  device::Buffer<float> candidate_position_, candidate_area_m2_, candidate_weight_;
  device::Buffer<float> position_, normal_, albedo_, color_, spacing_m_;
  device::Buffer<std::uint32_t> object_id_, pixel_;
};

}  // namespace splatbus::capture_bridge
