#include "splats/file.h"

#include <fmt/format.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <stdexcept>

#include "splats/glb.h"
#include "splats/ply.h"
#include "splats/spz.h"

namespace splatbus::splats {

Format format_of(const std::string& path) {
  if (path.ends_with(".ply")) return Format::Ply;
  if (path.ends_with(".glb")) return Format::Glb;
  if (path.ends_with(".spz")) return Format::Spz;
  throw std::runtime_error(fmt::format("{}: .ply, .glb and .spz can be written", path));
}

void write(std::ostream& stream, Format format, const BakedModel& model, const WriteOptions& options) {
  switch (format) {
    case Format::Ply:
      return write_ply(stream, model, options);
    case Format::Glb:
      return write_glb(stream, model, options);
    case Format::Spz:
      return write_spz(stream, model, options);
  }
}

std::size_t write_file(const std::string& path, const GaussiansView& gaussians, const SceneState& scene,
                       const WriteOptions& options) {
  const Format format = format_of(path);
  const BakedModel model(gaussians, scene);
  const std::string partial = path + ".partial";
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  std::string reason;
  if (file) {
    try {
      write(file, format, model, options);
    } catch (const std::runtime_error& error) {
      reason = error.what();
    }
  }
  file.close();
  if (reason.empty() && file && std::rename(partial.c_str(), path.c_str()) == 0) return model.count();
  if (reason.empty()) reason = std::strerror(errno);
  std::remove(partial.c_str());
  throw std::runtime_error(fmt::format("{}: cannot be written: {}", path, reason));
}

SplatFile read_file(const std::string& path, Axes axes) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(fmt::format("{}: cannot be opened", path));
  const int first = file.peek();
  file.clear();
  return is_spz(first) ? read_spz(file, path, axes) : read_ply(file, path, axes);
}

}  // namespace splatbus::splats
