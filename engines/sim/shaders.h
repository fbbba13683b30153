#pragma once

#include <cstddef>
#include <string>

#include "gl/objects.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::sim {

/// Depth maps of the sun in a wide scene, the finest first.
inline constexpr int kCascades = 3;
/// A receiver is lifted by so many texels along its normal before it is compared with a depth map.
inline constexpr float kLiftTexels = 1.5F;

/// What a fragment shader computes.
struct ShaderVariant {
  enum class Kind { Depth, Geometry, Shade } kind = Kind::Shade;
  bool lit = false;       ///< Shade only
  bool albedo = false;    ///< Shade only
  bool emissive = false;  ///< lit only: colour is albedo
  bool cascades = false;  ///< lit only: the sun has kCascades depth maps, not one
  bool sources = false;   ///< lit only: there are lights besides the sun
  bool holes = false;     ///< texels under an alpha cutoff are discarded
  int supersample = 2;    ///< Shade only: shadow taps are shared out among a pixel's supersamples

  auto operator<=>(const ShaderVariant&) const = default;  // NOLINT(modernize-use-nullptr): the check misreads <=>
};

/// Uniform locations, the same in every program.
enum UniformLocation : GLint {
  kCommandCount = 0,  ///< of the instance program alone
  kClipFromWorld = 2,
  kViewZ = 3,            ///< vec4: metres along the camera's z = dot(kViewZ, world position)
  kShadowFromWorld = 4,  ///< to texture coordinates and depth in [0, 1]
  kSunDirection = 8,
  kSunOverPi = 9,
  kShadowNormal = 10,  ///< mat3: a world normal to the plane that it stands for in shadow coordinates
  kShadowFilter =
      11,  ///< vec4: radius in texture coordinates (2), greatest depth slope, lift along the normal in metres
  kAmbientReflected = 12,                           ///< vec3[9]
  kSoftness = 21,                                   ///< with cascades or sources: radius of the filter in metres
  kCascadeCameras = 22,                             ///< MapCamera[kCascades]
  kCascadeLayers = kCascadeCameras + 4 * kCascades  ///< float[kCascades]
};

/// Of the shader storage blocks that tell which enclosed objects are seen.
enum StorageBinding : GLuint { kSeen = 0, kCommands = 1, kObjectOfPart = 2 };

/// Texture units.
enum TextureUnit : GLuint { kBaseTextures = 0, kSunMaps = 1, kLocalMaps = 2, kDirectionalMaps = 3 };
/// Of the uniform block that lists the lights besides the sun.
inline constexpr GLuint kSourcesBinding = 0;

/// Vertex attribute locations; those from kWorldFromPart are a part's.
enum AttributeLocation : GLuint {
  kPosition = 0,
  kNormal = 1,
  kUv = 2,
  kTint = 3,
  kWorldFromPart = 4,  ///< mat4
  kNormalMatrix = 8,   ///< mat3
  kBaseAndCutoff = 11,
  kIdAndLayer = 12,
  kObjectIndex = 13
};

/// Throws std::runtime_error with the compiler's words.
[[nodiscard]] GlProgram build_program(const ShaderVariant& variant);

/// Of two stages, without their version. Throws as above.
[[nodiscard]] GlProgram build_program(const char* vertex_text, const char* fragment_text);
[[nodiscard]] GlProgram build_compute_program(const char* text);

/// Averages `supersample`^2 pixels of `samples` samples each from the multisampled textures at units 0 (lit) and 1
/// (albedo), and writes both under the sRGB curve, alpha linear.
[[nodiscard]] GlProgram build_resolve_program(int supersample, int samples, bool lit, bool albedo);

}  // namespace splatbus::sim
