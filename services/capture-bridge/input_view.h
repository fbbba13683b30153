#pragma once

#include <array>
#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <span>
#include <vector>

#include "bus/memory_pool.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"

namespace splatbus::capture_bridge {

using Rgba8 = std::array<std::uint8_t, 4>;

/// Bytes of an input view's pictures.
[[nodiscard]] constexpr std::size_t input_view_bytes(std::size_t pixels) {
  return pixels * 2 * (sizeof(glm::vec4) + sizeof(Rgba8));
}

/// One input camera's buffers of one engine frame, row 0 on top; every picture has width * height pixels. Values are
/// the engine's, unchecked. Meanings: schemas/engine.fbs, EngineFrame. Copies share the pictures.
struct InputView {
  Camera camera;
  std::uint64_t frame = 0;
  double time_s = 0;
  std::int64_t capture_ns = 0;
  ObjectTransforms objects;
  Light light;
  Device memory = Device::Cpu;  ///< of the pictures
  std::span<glm::vec4> position;                   ///< world, metres; w: object id, 0 where there is no surface
  std::span<glm::vec4> normal;                     ///< world
  std::span<Rgba8> color, albedo;

  [[nodiscard]] std::size_t pixels() const {
    return static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  }

  /// Makes room for the pictures of `camera` in one block of the pool, whatever they held.
  void allocate(bus::MemoryPool& pool);
  /// Copies the pictures of a view of that size, both allocated, from whichever memory they lie in, and waits for it.
  void copy_pictures(const InputView& from);

 private:
  std::shared_ptr<std::byte> block_;
};

/// The views of a round. None is null; they are owned elsewhere.
using Views = std::span<const InputView* const>;

/// Samples of a round as structure of arrays; meanings in schemas/capture.fbs, CaptureInput.
struct SampleSet {
  std::vector<glm::vec3> position, normal, albedo, color;
  std::vector<float> footprint_m, spacing_m, cosine;
  std::vector<std::uint32_t> object_id, camera;

  [[nodiscard]] std::size_t size() const { return position.size(); }
  void resize(std::size_t count);
};

}  // namespace splatbus::capture_bridge
