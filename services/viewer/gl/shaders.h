#pragma once

// The page's quads and formula (web/src/render/splat.glsl), in its order, which a test holds to the CPU rasteriser's
// pictures, as OpenGL 4.5 has them.
namespace splatbus::viewer::gl {

/// Quads of one instance: batches are several times faster than one quad an instance.
inline constexpr int kBatch = 128;
/// How long a row takes to appear and to vanish.
inline constexpr float kFade_s = 0.25F;
/// Rows that a group of kScatterText writes.
inline constexpr int kScatterGroup = 64;

/// Quads that cover exactly what a Gaussian can reach: a square in the whitened plane, brought to pixels by the
/// Cholesky factor of the covariance. Any root of it would do; all have the same area.
extern const char* const kSplatVertexText;
extern const char* const kSplatFragmentText;
/// Background and sRGB curve over the splats' picture.
extern const char* const kResolveVertexText;
extern const char* const kResolveFragmentText;
/// Writes changed rows to where they belong, so that what is uploaded is what changed.
extern const char* const kScatterText;

// Bindings of the storage buffers.
inline constexpr unsigned kRecordBinding = 0;    ///< uvec4[2] a row: GpuRecord
inline constexpr unsigned kFadeBinding = 1;      ///< float a row
inline constexpr unsigned kOrderBinding = 2;     ///< uint a Gaussian that is drawn
inline constexpr unsigned kObjectBinding = 3;    ///< vec4[3] an object: camera_from_object
inline constexpr unsigned kHarmonicBinding = 4;  ///< uint[uHarmonicWords] a row
// Of what kScatterText reads.
inline constexpr unsigned kChangedRowBinding = 5;
inline constexpr unsigned kChangedRecordBinding = 6;
inline constexpr unsigned kChangedFadeBinding = 7;

// Uniform locations.
enum Location : int {
  kCount = 0,
  kPinhole = 1,
  kSize = 2,
  kTangents = 3,
  kTime = 4,
  kAntialias = 5,
  kHarmonicWords = 6,
  kBackground = 7,
  kDisplaySpace = 8,
  kChanged = 9,
  kColorOnly = 10,
  kNear = 11
};

}  // namespace splatbus::viewer::gl
