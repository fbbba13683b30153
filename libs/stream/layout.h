#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gaussians/model.h"
#include "wire/stream_generated.h"

namespace splatbus::stream {

using wire::Attribute;

// What no packet may exceed; checked before anything is allocated.
inline constexpr std::size_t kMaxGaussians = std::size_t{1} << 22;       ///< that a streamer serves and a viewer takes
inline constexpr std::size_t kMaxChunkGaussians = std::size_t{1} << 16;  ///< in one Draco point cloud
inline constexpr std::size_t kMaxDeltaGaussians = std::size_t{1} << 20;  ///< lanes of all pages of one packet
inline constexpr std::size_t kMaxDeltaPages = 4096;                      ///< in one PageDelta or LightVisibility
inline constexpr std::size_t kMaxPageNumber = std::size_t{1} << 20;      ///< pages are below it
inline constexpr std::size_t kMaxObjects = 32768 + 1;                    ///< as an engine shows, and the far field
inline constexpr std::size_t kMaxPacketBytes = std::size_t{1} << 20;     ///< the FlatBuffer
inline constexpr std::size_t kMaxPayloadBytes = std::size_t{1} << 28;    ///< the payload frame

/// value = offset + step * q, in the attribute's coding space (below). Finite, step > 0.
struct Quantizer {
  float offset = 0, step = 1;
  bool operator==(const Quantizer&) const = default;
};

/// One attribute's channels among the integer planes of a stream.
struct AttributeChannels {
  Attribute attribute{};
  int first = 0, channels = 0;
  std::int32_t minimum = 0, maximum = 0;  ///< of q; whatever lies outside is refused
  Quantizer quantizer;
  bool operator==(const AttributeChannels&) const = default;
};

/// Which attributes a stream carries, in which order, and how each is quantized. Coding space of the attributes:
///
///   Mean        metres, object's frame                LogScale   as in the model
///   Rotation    rotation vector (axis times angle), of that one among the four rotations with the same covariance
///               (they differ by half a turn about one of the Gaussian's axes) which is nearest to what is held
///   Opacity     sigmoid(logit), q in 0..255           Albedo     sRGB curve, odd, going on above 1
///   Residual, ShDc, ShRest  as in the model           Normal     octahedral (Meyer et al. 2010), in [-1, 1]
///   Visibility  q in 0..255
///
/// Transfer: Mean, LogScale, Rotation, Opacity, Albedo, Residual, Normal, Visibility. Radiance: Mean, LogScale,
/// Rotation, Opacity, ShDc, ShRest (degree 1 and up).
class StreamLayout {
 public:
  StreamLayout() : StreamLayout(ParameterLayout{}, 1.0F) {}

  /// The streamer's choice. `mean_step_m`: see ModelQuantizer::choose_mean_step.
  StreamLayout(const ParameterLayout& parameters, float mean_step_m);

  /// As a Layout says. Throws StreamError.
  static StreamLayout from_wire(const wire::Layout& wired);

  /// With the default sh_degree where the appearance has none.
  [[nodiscard]] const ParameterLayout& parameters() const { return parameters_; }
  /// Whether Gaussians of this layout can be streamed with it.
  [[nodiscard]] bool carries(const ParameterLayout& parameters) const;
  [[nodiscard]] const std::vector<AttributeChannels>& attributes() const { return attributes_; }
  [[nodiscard]] int channels() const { return channels_; }
  /// Null when the layout has no such attribute.
  [[nodiscard]] const AttributeChannels* find(Attribute attribute) const;
  /// Asserts that the layout has it.
  [[nodiscard]] const AttributeChannels& at(Attribute attribute) const;

  bool operator==(const StreamLayout&) const = default;

 private:
  void add(Attribute attribute, int channels, Quantizer quantizer, std::int32_t minimum, std::int32_t maximum);

  ParameterLayout parameters_;
  std::vector<AttributeChannels> attributes_;
  int channels_ = 0;
};

/// The first of ParameterLayout's channels that the attribute is made from; Normal and Visibility have planes of their
/// own.
[[nodiscard]] int parameter_channel(Attribute attribute);

inline constexpr float kDefaultMeanStep_m = 1.0F / 2048;
/// ModelQuantizer::choose_mean_step from the median of the log of the extents.
[[nodiscard]] float mean_step_for(float median_log_extent);

}  // namespace splatbus::stream
