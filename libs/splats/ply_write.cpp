#include <fmt/format.h>

#include <bit>
#include <vector>

#include "splats/ply.h"
#include "splats/ply_header.h"

namespace splatbus::splats {

namespace {

static_assert(std::endian::native == std::endian::little, "rows are written as they lie in memory");

std::string header(const BakedModel& model, const WriteOptions& options) {
  std::string text = "ply\nformat binary_little_endian 1.0\n";
  if (options.mip) text += fmt::format("comment {}\n", kPlyMip);
  if (options.axes == Axes::Keep) text += fmt::format("comment {}\n", kPlyYUp);
  text += fmt::format("element vertex {}\n", model.count());
  const auto property = [&text](const std::string& name) { text += fmt::format("property float {}\n", name); };
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) property(name);
  for (int c = 0; c < 3; ++c) property(fmt::format("f_dc_{}", c));
  for (int k = 0; k < 3 * (model.sh_coefficients() - 1); ++k) property(fmt::format("f_rest_{}", k));
  property("opacity");
  for (int axis = 0; axis < 3; ++axis) property(fmt::format("scale_{}", axis));
  for (int k = 0; k < 4; ++k) property(fmt::format("rot_{}", k));
  return text + "end_header\n";
}

}  // namespace

void write_ply(std::ostream& stream, const BakedModel& model, const WriteOptions& options) {
  stream << header(model, options);
  const auto coefficients = static_cast<std::size_t>(model.sh_coefficients());
  std::vector<float> row;
  const auto append = [&row](const glm::vec3& v) { row.insert(row.end(), {v.x, v.y, v.z}); };
  for (std::size_t i = 0; i < model.count(); ++i) {
    const Splat splat = options.axes == Axes::Keep ? model[i] : turned(model[i]);
    row.clear();
    append(splat.mean);
    append(splat.normal);
    append(splat.sh[0]);
    for (int c = 0; c < 3; ++c) {  // all of red before green
      for (std::size_t k = 1; k < coefficients; ++k) row.push_back(splat.sh[k][c]);
    }
    row.push_back(splat.opacity_logit);
    append(splat.log_scale);
    row.insert(row.end(), {splat.rotation.w, splat.rotation.x, splat.rotation.y, splat.rotation.z});
    stream.write(reinterpret_cast<const char*>(row.data()), static_cast<std::streamsize>(row.size() * sizeof(float)));
  }
}

}  // namespace splatbus::splats
