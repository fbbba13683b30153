#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "bus/slab.h"
#include "expander/grid.h"
#include "expander/input_samples.h"
#include "expander/insert_planes.h"

namespace splatbus::expander {

/// New Gaussians as model/insert carries them, in either kind of memory. Frames and units: schemas/model.fbs,
/// ModelInsert. Copies share the planes, which nobody changes once the batch is made.
struct InsertBatch {
  std::uint64_t batch = 0;  ///< unique within this process
  std::int64_t capture_ns = 0;
  ObjectTransforms objects;
  Light light;
  std::size_t count = 0;
  Device memory = Device::Cpu;
  std::shared_ptr<std::byte> data;  ///< insert_planes(data.get(), count) says what lies where

  [[nodiscard]] std::size_t size() const { return count; }
  [[nodiscard]] std::size_t bytes() const { return count * kInsertBytes; }
  [[nodiscard]] InsertPlanes planes() const { return insert_planes(data.get(), count); }
};

struct InitialOptions {
  float scale = 0.42F;    ///< standard deviation along the surface, of the spacing
  float flatness = 0.2F;  ///< the axis along the normal, of the others
  float opacity = 0.95F;
};

inline constexpr float kLeastSpacing_m = 1e-4F;
inline constexpr float kLeastSunPart = 0.02F;  ///< luminance; below this the sun's visibility cannot be told

/// Samples to flat Gaussians in host memory: the local z axis lies along the normal.
[[nodiscard]] InsertBatch initial_gaussians(const InputSamples& samples, std::span<const Chosen> chosen,
                                            const InitialOptions& options);

/// Rotation, w x y z, that turns z into a unit normal the shortest way.
[[nodiscard]] glm::quat rotation_to_normal(const glm::vec3& normal);

/// How much of the sun reached a surface of that albedo and normal (world) when it was seen in that colour: (colour -
/// ambient part) / sun part, on luminance, in [0, 1]. 1 where the sun would not show anyway.
[[nodiscard]] float guess_visibility(const glm::vec3& color, const glm::vec3& albedo, const glm::vec3& normal,
                                     const Light& light);

}  // namespace splatbus::expander
