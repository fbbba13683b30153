#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>

#include "gaussians/transfer.h"
#include "stream/held_gaussians.h"

namespace splatbus::stream {

/// A Gaussian as a GPU reads it, little endian: what of it does not depend on the camera, in the frame of its object.
struct GpuRecord {
  std::array<float, 3> mean{};              ///< metres
  std::array<std::int16_t, 3> log_scale{};  ///< natural logarithm of metres, kLogScaleStep
  std::array<std::int16_t, 3> rotation{};   ///< vector of at most half a turn, kRotationStep_rad
  std::uint32_t opacity_object = 0;         ///< opacity, of 255, in the lowest byte; above it the object's index
  std::uint32_t color = 0;                  ///< rgb9e5: red lowest. Transfer: linear; Radiance: display space, degree 0
  bool operator==(const GpuRecord&) const = default;
};
static_assert(sizeof(GpuRecord) == 32);
inline constexpr float kLogScaleStep = 1.0F / 1024;
inline constexpr float kRotationStep_rad = 3.14159265F / 32767;

/// Three numbers of 9 bits and an exponent they share, as OpenGL's RGB9_E5 and WebGPU's rgb9e5ufloat: what is negative
/// or no number becomes 0, what is too large 65408.
[[nodiscard]] std::uint32_t shared_exponent_rgb(const glm::vec3& color);

/// Words of a Gaussian's harmonics, [coefficient][RGB] as two half floats a word, the rest of them 0: Radiance above
/// degree 0, in display space, the constant one being 0.5 + kShC0 times itself. A multiple of four; 0 for any other
/// layout.
[[nodiscard]] std::size_t harmonic_words(const StreamLayout& layout);

/// Makes records of the columns of Gaussians that it was made for and that stay as they are meanwhile.
class RecordMaker {
 public:
  RecordMaker(const HeldGaussians& gaussians, const StreamLayout& layout);

  [[nodiscard]] GpuRecord record(std::size_t column, std::uint32_t object_index) const;
  /// The record's color; `light_object` and `visibility` as shade_transfer takes them, not looked at for Radiance.
  [[nodiscard]] std::uint32_t color(std::size_t column, std::span<const float> visibility,
                                    const Light& light_object) const;
  /// `out`: harmonic_words() of the layout.
  void harmonics(std::size_t column, std::span<std::uint32_t> out) const;
  /// How much of the sun is seen, in [0, 1].
  [[nodiscard]] float sun_visibility(std::size_t column) const;

 private:
  [[nodiscard]] float value(const AttributeChannels& a, int channel, std::size_t column) const {
    return a.quantizer.offset + a.quantizer.step * static_cast<float>(gaussians_.channels[a.first + channel][column]);
  }
  [[nodiscard]] glm::vec3 triple(const AttributeChannels& a, int first, std::size_t column) const {
    return {value(a, first, column), value(a, first + 1, column), value(a, first + 2, column)};
  }

  /// Linear, from the albedo's coding space.
  [[nodiscard]] float albedo(int channel, std::size_t column) const;

  static constexpr std::size_t kTabled = 256;

  const HeldGaussians& gaussians_;
  bool transfer_;
  std::array<float, kTabled> albedo_{};  ///< of 0, 1, ... steps
  AttributeChannels mean_, log_scale_, rotation_, opacity_, color_, residual_, normal_, visibility_, rest_;
};

}  // namespace splatbus::stream
