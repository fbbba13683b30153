#pragma once

#include <cstddef>
#include <cstdint>
#include <ostream>
#include <string>

#include "gaussians/light.h"
#include "gaussians/model.h"
#include "splats/axes.h"
#include "splats/baked_model.h"

// Models as files that other programs read and write. docs/files.md says what each format keeps.
namespace splatbus::splats {

enum class Format : std::uint8_t { Ply, Glb, Spz };

/// By the name's end: .ply, .glb or .spz. Throws std::runtime_error that names the path and those.
[[nodiscard]] Format format_of(const std::string& path);

struct WriteOptions {
  Axes axes = Axes::OfFormat;
  /// Trained with the 2D filter of Mip-Splatting (RenderOptions::antialias), as our models are: others show them too
  /// opaque without it. PLY and SPZ have a mark for it, glTF has none.
  bool mip = true;
  int spz_version = 4;  ///< or 3, for older readers
};

/// Throws std::runtime_error where the format cannot hold the model: no Gaussian at all in .glb and .spz, 4 GiB or more
/// in .glb. Whether all of it was written, the stream says.
void write(std::ostream& stream, Format format, const BakedModel& model, const WriteOptions& options = {});

/// Beside the path and renamed, so that a reader never meets half a file. Returns how many Gaussians were written.
/// Throws std::runtime_error that names the path.
std::size_t write_file(const std::string& path, const GaussiansView& gaussians, const SceneState& scene,
                       const WriteOptions& options = {});

struct SplatFile {
  GaussiansBuffer gaussians;  ///< Radiance, in the world's frame
  bool mip = false;           ///< as WriteOptions'
};

/// .ply or .spz, by how it begins. Throws std::runtime_error that names the file, where in it, and what was wrong.
[[nodiscard]] SplatFile read_file(const std::string& path, Axes axes = Axes::OfFormat);

}  // namespace splatbus::splats
