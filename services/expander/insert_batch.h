#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "expander/grid.h"
#include "expander/input_samples.h"

namespace splatbus::expander {

/// New Gaussians as model/insert carries them: planes [channels][n]. Frames and units: schemas/model.fbs, ModelInsert.
struct InsertBatch {
  std::uint64_t batch = 0;  ///< unique within this process
  std::int64_t capture_ns = 0;
  ObjectTransforms objects;
  Light light;
  std::vector<float> mean, log_scale, rotation, opacity_logit, albedo, normal, visibility;
  std::vector<std::uint32_t> object_id;
  std::vector<CellId> cell;

  [[nodiscard]] std::size_t size() const { return object_id.size(); }
  [[nodiscard]] std::size_t bytes() const {
    return size() * (18 * sizeof(float) + sizeof(std::uint32_t) + sizeof(CellId));
  }
};

struct InitialOptions {
  float scale = 0.42F;    ///< standard deviation along the surface, of the spacing
  float flatness = 0.2F;  ///< the axis along the normal, of the others
  float opacity = 0.95F;
};

/// Samples to flat Gaussians: the local z axis lies along the normal.
[[nodiscard]] InsertBatch initial_gaussians(const InputSamples& samples, std::span<const Chosen> chosen,
                                            const InitialOptions& options);

/// Rotation, w x y z, that turns z into a unit normal the shortest way.
[[nodiscard]] glm::quat rotation_to_normal(const glm::vec3& normal);

/// How much of the sun reached a surface of that albedo and normal (world) when it was seen in that colour: (colour -
/// ambient part) / sun part, on luminance, in [0, 1]. 1 where the sun would not show anyway.
[[nodiscard]] float guess_visibility(const glm::vec3& color, const glm::vec3& albedo, const glm::vec3& normal,
                                     const Light& light);

}  // namespace splatbus::expander
