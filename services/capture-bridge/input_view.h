#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <glm/glm.hpp>
#include <memory>
#include <optional>
#include <span>

#include "bus/memory_pool.h"
#include "bus/subscriber.h"
#include "gaussians/camera.h"
#include "gaussians/light.h"
#include "wire/engine_generated.h"

namespace splatbus::capture_bridge {

using Rgba8 = std::array<std::uint8_t, 4>;

/// Bytes of an input view's pictures.
[[nodiscard]] constexpr std::size_t input_view_bytes(std::size_t pixels) {
  return pixels * (2 * (sizeof(glm::vec4) + sizeof(Rgba8)) + sizeof(std::uint32_t));
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
  std::uint64_t scene_version = 0;
  Device memory = Device::Cpu;         ///< of the pictures
  std::span<glm::vec4> position;       ///< world, metres
  std::span<glm::vec4> normal;         ///< world
  std::span<std::uint32_t> object_id;  ///< 0 where there is no surface
  std::span<Rgba8> color, albedo;

  [[nodiscard]] std::size_t pixels() const {
    return static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  }

  /// Makes room for the pictures of `camera` in one block of the pool, whatever they held.
  void allocate(bus::MemoryPool& pool);
  /// All of them, input_view_bytes(pixels()) in the order in which they stand above.
  [[nodiscard]] const std::byte* pictures() const { return block_.get(); }
  /// Copies pictures() of a view of that size, this one allocated, and waits for it. False when they were overwritten
  /// meanwhile. Adds to `host_bytes` what did not stay on the device. Throws bus::Error.
  [[nodiscard]] bool take_pictures(const bus::TensorView& from, std::atomic<std::uint64_t>& host_bytes);
  /// Copies the pictures of a view of that size, both allocated, from whichever memory they lie in, and waits for it.
  void copy_pictures(const InputView& from);

 private:
  std::shared_ptr<std::byte> block_;
};

/// The views of a round. None is null; they are owned elsewhere.
using Views = std::span<const InputView* const>;

/// What is to be expected of a round.
struct RoundSizes {
  std::size_t views = 0;
  std::size_t pixels = 0;  ///< of each view
  std::size_t samples = 0;
};

/// Copies an input camera's frame out of the engine's slab into memory of the pool; the copies are done when this
/// returns. Adds to `host_bytes` what did not stay on the device. Nullopt when a buffer is gone or overwritten already
/// (a lost frame). Throws bus::Error or std::runtime_error, naming what is wrong, when the message lies.
[[nodiscard]] std::optional<InputView> decode_input_frame(const bus::Message& message, const wire::EngineFrame& frame,
                                                          bus::MemoryPool& pool,
                                                          std::atomic<std::uint64_t>& host_bytes);

}  // namespace splatbus::capture_bridge
