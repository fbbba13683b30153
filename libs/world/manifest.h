#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "gaussians/layout.h"

namespace splatbus::world {

/// "world.splatbus": what a folder is, as a whole.
struct Manifest {
  ParameterLayout layout;
  std::uint64_t world_id = 0;  ///< random; its segments carry it
  std::uint64_t epoch = 0;     ///< how often it has been opened to be written
  std::string note;            ///< whatever whoever made it wants to say of it
};

[[nodiscard]] std::filesystem::path manifest_path(const std::filesystem::path& folder);
/// Throws WorldError that names the file when it is not a manifest, or one of another version.
[[nodiscard]] Manifest read_manifest(const std::filesystem::path& folder);
void write_manifest(const std::filesystem::path& folder, const Manifest& manifest);

}  // namespace splatbus::world
