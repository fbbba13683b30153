#include <fmt/format.h>

#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <vector>

#include "gaussians/model.h"
#include "gaussians/sh.h"
#include "gaussians/transfer.h"

namespace splatbus {
namespace {

static_assert(std::endian::native == std::endian::little, "rows are written as they lie in memory");

/// What all Gaussians of one object share.
struct ObjectFrame {
  ObjectTransform world_from_object;
  bool moved = false;
  Light light;               // in the object's frame
  ShRotation sh_rotation{};  // world from object
};

class ObjectFrames {
 public:
  explicit ObjectFrames(const SceneState& scene) : still_{{}, false, scene.light, {}} {
    // The far field about the origin: other programs have no frame that goes with the camera.
    const ObjectTransform far = seen_from(glm::vec3(0), kFarFieldFrame, {});
    frames_.emplace(kFarFieldFrame,
                    ObjectFrame{far, true, light_in_object(scene.light, far), sh_rotation(far.rigid.rotation)});
    for (const auto& [id, world_from_object] : scene.objects) {
      frames_.emplace(id, ObjectFrame{world_from_object, true, light_in_object(scene.light, world_from_object),
                                      sh_rotation(world_from_object.rigid.rotation)});
    }
  }
  [[nodiscard]] const ObjectFrame& operator[](std::uint32_t id) const {
    const auto found = frames_.find(id);
    return found == frames_.end() ? still_ : found->second;
  }

 private:
  ObjectFrame still_;
  std::map<std::uint32_t, ObjectFrame> frames_;
};

std::string header(std::size_t count, int sh_coefficients) {
  std::string text = fmt::format("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", count);
  const auto property = [&text](const std::string& name) { text += fmt::format("property float {}\n", name); };
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) property(name);
  for (int c = 0; c < 3; ++c) property(fmt::format("f_dc_{}", c));
  for (int k = 0; k < 3 * (sh_coefficients - 1); ++k) property(fmt::format("f_rest_{}", k));
  property("opacity");
  for (int axis = 0; axis < 3; ++axis) property(fmt::format("scale_{}", axis));
  for (int k = 0; k < 4; ++k) property(fmt::format("rot_{}", k));
  return text + "end_header\n";
}

/// The Gaussians that other tools can read: a live model may hold one that training has just spoilt.
std::vector<std::size_t> finite_gaussians(const GaussiansView& gaussians) {
  std::vector<std::size_t> finite;
  finite.reserve(gaussians.count);
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    float sum = 0, rotation = 0;  // each term is 0 or NaN, which stays
    for (int c = 0; c < gaussians.layout.channels(); ++c) sum += 0 * gaussians.plane(c)[i];
    for (int k = 0; k < 4; ++k) {
      const float q = gaussians.plane(ParameterLayout::kRotation + k)[i];
      rotation += q * q;
    }
    for (std::size_t axis = 0; axis < 3 && gaussians.normal != nullptr; ++axis) {
      sum += 0 * gaussians.normal[axis * gaussians.stride + i];
    }
    if (gaussians.visibility != nullptr) sum += 0 * gaussians.visibility[i];
    if (sum == 0 && rotation > 0 && std::isfinite(rotation)) finite.push_back(i);
  }
  return finite;
}

glm::vec3 triple(const float* planes, std::size_t stride, std::size_t i) {
  return {planes[i], planes[stride + i], planes[2 * stride + i]};
}

/// SH coefficients in the order of the file: the constant ones, then the rest, red before green before blue.
void append_appearance(const GaussiansView& gaussians, std::size_t i, const ObjectFrame& frame,
                       std::vector<float>& row) {
  if (gaussians.layout.appearance == Appearance::Transfer) {
    const glm::vec3 color = shade_transfer(gaussians, i, frame.light);
    for (int c = 0; c < 3; ++c) row.push_back((srgb_from_linear(color[c]) - 0.5F) / kShC0);
    return;
  }
  const auto coefficients = static_cast<std::size_t>(gaussians.layout.sh_coefficients());
  const auto local = [&](std::size_t k, std::size_t c) {
    return gaussians.plane(ParameterLayout::kAppearance + static_cast<int>(3 * k + c))[i];
  };
  for (std::size_t c = 0; c < 3; ++c) row.push_back(local(0, c));
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t k = 1; k < coefficients; ++k) {
      float value = frame.moved ? 0.0F : local(k, c);
      if (frame.moved) {
        for (std::size_t j = 1; j < coefficients; ++j) value += frame.sh_rotation[k][j] * local(j, c);
      }
      row.push_back(value);
    }
  }
}

void append_row(const GaussiansView& gaussians, std::size_t i, const ObjectFrame& frame, std::vector<float>& row) {
  const auto append = [&row](const glm::vec3& v) { row.insert(row.end(), {v.x, v.y, v.z}); };
  const ObjectTransform& world_from_object = frame.world_from_object;
  append(world_from_object * triple(gaussians.plane(ParameterLayout::kMean), gaussians.stride, i));
  const glm::vec3 normal = gaussians.normal != nullptr ? triple(gaussians.normal, gaussians.stride, i) : glm::vec3(0);
  append(world_from_object.rigid.rotation * normal);
  append_appearance(gaussians, i, frame, row);
  row.push_back(gaussians.plane(ParameterLayout::kOpacityLogit)[i]);
  append(triple(gaussians.plane(ParameterLayout::kLogScale), gaussians.stride, i) + std::log(world_from_object.scale));
  const auto component = [&](int k) { return gaussians.plane(ParameterLayout::kRotation + k)[i]; };
  const glm::quat local(component(0), component(1), component(2), component(3));
  const glm::quat world = world_from_object.rigid.rotation * glm::normalize(local);
  row.insert(row.end(), {world.w, world.x, world.y, world.z});
}

}  // namespace

void write_ply(const std::string& path, const GaussiansView& gaussians, const SceneState& scene) {
  // Written beside the target and renamed, so that a reader never meets half a file.
  const std::string partial = path + ".partial";
  const auto fail = [&partial](const std::string& name) {
    const std::string reason = std::strerror(errno);
    std::remove(partial.c_str());
    throw std::runtime_error(fmt::format("{}: cannot be written: {}", name, reason));
  };
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  if (!file) fail(path);
  const bool transfer = gaussians.layout.appearance == Appearance::Transfer;
  const std::vector<std::size_t> finite = finite_gaussians(gaussians);
  file << header(finite.size(), transfer ? 1 : gaussians.layout.sh_coefficients());
  const ObjectFrames frames(scene);
  std::vector<float> row;
  for (const std::size_t i : finite) {
    row.clear();
    append_row(gaussians, i, frames[gaussians.object_id != nullptr ? gaussians.object_id[i] : 0], row);
    file.write(reinterpret_cast<const char*>(row.data()), static_cast<std::streamsize>(row.size() * sizeof(float)));
  }
  file.close();
  if (!file || std::rename(partial.c_str(), path.c_str()) != 0) fail(path);
}

}  // namespace splatbus
