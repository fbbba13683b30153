#include "bench/town_scene.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>
#include <limits>
#include <numeric>
#include <random>

#include "sim/world.h"

namespace splatbus::bench {

namespace {

constexpr float kPatch_m = 1.5F;    // edges of what has one density
constexpr float kNear_m = 3;        // of the walk, within which Gaussians are densest
constexpr float kSpread = 0.55F;    // deviation of a disk, of the distance to its neighbours
constexpr float kThickness = 0.1F;  // of the other deviations
constexpr float kOpacityLogit = 3.5F;
constexpr std::size_t kWalkStride = 4;  // points of the walk that distances are taken to, 2 m apart

struct Corner {
  glm::vec3 position, normal;
  glm::vec2 uv;
  glm::vec3 tint;
};
Corner middle(const Corner& a, const Corner& b) {
  return {0.5F * (a.position + b.position), a.normal + b.normal, 0.5F * (a.uv + b.uv), 0.5F * (a.tint + b.tint)};
}

struct Patch {
  Corner a, b, c;
  int material = 0;
  float area_m2 = 0, distance_m = 0;
  /// Gaussians a square metre, to a factor.
  [[nodiscard]] double density() const { return std::pow(std::max(1.0F, distance_m / kNear_m), -2.0); }
};

class Patches {
 public:
  Patches(const sim::Scene& scene, const std::vector<glm::vec3>& walk) {
    for (std::size_t i = 0; i < walk.size(); i += kWalkStride) places_.push_back(walk[i]);
    for (const sim::Object& object : scene.objects) {
      if (object.motion || !object.modelled || object.emissive) continue;
      for (const sim::Part& part : object.parts) add(part, object.world_from_object);
    }
  }
  [[nodiscard]] const std::vector<Patch>& all() const { return patches_; }

 private:
  void add(const sim::Part& part, const glm::mat4& world_from_object) {
    const glm::mat3 turn(world_from_object);
    const auto corner = [&](std::uint32_t index) -> Corner {
      const sim::Vertex& v = part.mesh.vertices[index];
      return {glm::vec3(world_from_object * glm::vec4(v.position, 1)), turn * v.normal, v.uv,
              glm::vec3(v.tint) / 255.0F};
    };
    for (std::size_t i = 0; i + 2 < part.mesh.indices.size(); i += 3) {
      split(corner(part.mesh.indices[i]), corner(part.mesh.indices[i + 1]), corner(part.mesh.indices[i + 2]),
            part.material);
    }
  }

  /// The longest edge in two, until each is short.
  void split(const Corner& a, const Corner& b, const Corner& c, int material) {
    const float ab = glm::distance(a.position, b.position), bc = glm::distance(b.position, c.position),
                ca = glm::distance(c.position, a.position);
    const float longest = std::max({ab, bc, ca});
    if (longest > kPatch_m) {
      const bool first = longest == ab, second = !first && longest == bc;
      const Corner &p = first ? a : second ? b : c, &q = first ? b : second ? c : a, &r = first ? c : second ? a : b;
      const Corner half = middle(p, q);
      split(p, half, r, material);
      split(half, q, r, material);
      return;
    }
    Patch patch{.a = a, .b = b, .c = c, .material = material};
    patch.area_m2 = 0.5F * glm::length(glm::cross(b.position - a.position, c.position - a.position));
    const glm::vec3 centre = (a.position + b.position + c.position) / 3.0F;
    float nearest = std::numeric_limits<float>::max();
    for (const glm::vec3& place : places_) nearest = std::min(nearest, glm::distance(place, centre));
    patch.distance_m = nearest;
    patches_.push_back(patch);
  }

  std::vector<glm::vec3> places_;
  std::vector<Patch> patches_;
};

/// What a surface shows there; false in a hole.
bool albedo_at(const sim::Scene& scene, int material_index, glm::vec2 uv, glm::vec3& albedo) {
  const sim::Material& material = scene.materials[static_cast<std::size_t>(material_index)];
  albedo = material.base_color;
  if (material.image < 0) return true;
  const sim::Image& image = scene.images[static_cast<std::size_t>(material.image)];
  uv = material.repeat ? uv - glm::floor(uv) : glm::clamp(uv, 0.0F, 1.0F);
  const auto at = [](float t, std::uint32_t n) {
    return std::min(static_cast<std::uint32_t>(t * static_cast<float>(n)), n - 1);
  };
  const std::uint8_t* texel =
      &image.rgba[4 * (std::size_t{at(uv.y, image.height)} * image.width + at(uv.x, image.width))];
  if (static_cast<float>(texel[3]) / 255 < material.alpha_cutoff) return false;
  for (int c = 0; c < 3; ++c) albedo[c] *= linear_from_srgb(static_cast<float>(texel[c]) / 255);
  return true;
}

struct Disk {
  glm::vec3 position, normal, albedo;
  float deviation_m = 0;
};

std::vector<Disk> scatter(const sim::Scene& scene, const std::vector<Patch>& patches, std::size_t gaussians,
                          std::uint32_t seed) {
  double weights = 0;
  for (const Patch& patch : patches) weights += patch.density() * static_cast<double>(patch.area_m2);
  const double per_weight = static_cast<double>(gaussians) / weights;
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> uniform(0, 1);
  std::vector<Disk> disks;
  disks.reserve(gaussians);
  for (const Patch& patch : patches) {
    const double per_m2 = patch.density() * per_weight, expected = per_m2 * static_cast<double>(patch.area_m2);
    const auto count = static_cast<int>(expected + static_cast<double>(uniform(random)));
    for (int k = 0; k < count; ++k) {
      const float root = std::sqrt(uniform(random)), v = uniform(random);
      const float wa = 1 - root, wb = root * (1 - v), wc = root * v;
      const auto mixed = [&](auto of) { return wa * of(patch.a) + wb * of(patch.b) + wc * of(patch.c); };
      Disk disk{.position = mixed([](const Corner& c) { return c.position; }),
                .normal = glm::normalize(mixed([](const Corner& c) { return glm::normalize(c.normal); })),
                .albedo = {},
                .deviation_m = kSpread / static_cast<float>(std::sqrt(per_m2))};
      if (!albedo_at(scene, patch.material, mixed([](const Corner& c) { return c.uv; }), disk.albedo)) continue;
      disk.albedo *= mixed([](const Corner& c) { return c.tint; });
      disks.push_back(disk);
    }
  }
  return disks;
}

std::uint64_t morton(const glm::vec3& cell) {
  std::uint64_t code = 0;
  for (int bit = 0; bit < 21; ++bit) {
    for (int c = 0; c < 3; ++c) {
      code |= (static_cast<std::uint64_t>(cell[c]) >> bit & 1U) << (3 * bit + c);
    }
  }
  return code;
}

void sort_along_curve(std::vector<Disk>& disks) {
  constexpr float kCell_m = 0.01F, kOrigin_m = -4096;
  std::vector<std::pair<std::uint64_t, std::size_t>> order(disks.size());
  for (std::size_t i = 0; i < disks.size(); ++i) {
    order[i] = {morton((disks[i].position - kOrigin_m) / kCell_m), i};
  }
  std::ranges::sort(order);
  std::vector<Disk> sorted;
  sorted.reserve(disks.size());
  for (const auto& [code, i] : order) sorted.push_back(disks[i]);
  disks = std::move(sorted);
}

GaussiansBuffer model_of(const std::vector<Disk>& disks) {
  GaussiansBuffer model(ParameterLayout{}, disks.size());
  const auto set = [&](int channel, std::size_t i, float value) {
    model.parameters[static_cast<std::size_t>(channel) * model.stride() + i] = value;
  };
  for (std::size_t i = 0; i < disks.size(); ++i) {
    const Disk& disk = disks[i];
    const glm::quat turn = glm::quat(glm::vec3(0, 0, 1), disk.normal);
    for (int c = 0; c < 3; ++c) {
      set(ParameterLayout::kMean + c, i, disk.position[c]);
      set(ParameterLayout::kLogScale + c, i, std::log(disk.deviation_m * (c == 2 ? kThickness : 1.0F)));
      set(ParameterLayout::kAlbedo + c, i, disk.albedo[c]);
      model.normal[static_cast<std::size_t>(c) * model.stride() + i] = disk.normal[c];
      model.surface_point[static_cast<std::size_t>(c) * model.stride() + i] = disk.position[c];
    }
    set(ParameterLayout::kRotation, i, turn.w);
    set(ParameterLayout::kRotation + 1, i, turn.x);
    set(ParameterLayout::kRotation + 2, i, turn.y);
    set(ParameterLayout::kRotation + 3, i, turn.z);
    set(ParameterLayout::kOpacityLogit, i, kOpacityLogit);
    model.visibility[i] = 1;
    model.gaussian_id[i] = i + 1;
  }
  return model;
}

std::vector<Camera> along(const std::vector<glm::vec3>& walk, std::size_t cameras, std::uint32_t width,
                          std::uint32_t height) {
  constexpr std::size_t kAhead = 6;  // points, 3 m
  std::vector<Camera> seen;
  for (std::size_t k = 0; k < cameras; ++k) {
    const std::size_t at = (2 * k + 1) * (walk.size() - kAhead - 1) / (2 * cameras);
    glm::vec3 target = walk[at + kAhead];
    target.y = walk[at].y - 0.2F;
    seen.push_back(look_at(walk[at], target, width, height, 1.0F));
    seen.back().near_m = 0.05F;
  }
  return seen;
}

}  // namespace

TownScene make_town_scene(std::size_t gaussians, std::uint32_t seed, std::size_t cameras, std::uint32_t width,
                          std::uint32_t height) {
  const sim::Scene town = sim::make_world(seed, false);
  const std::vector<glm::vec3> walk = sim::world_walk(seed);
  std::vector<Disk> disks = scatter(town, Patches(town, walk).all(), gaussians, seed);
  sort_along_curve(disks);
  TownScene scene{.model = model_of(disks), .walk = along(walk, cameras, width, height), .scene = {}};
  scene.scene.version = 1;
  scene.scene.light.ambient_sh[0] = glm::vec3(2);
  scene.scene.light.sun_direction = glm::normalize(glm::vec3(0.5F, 0.8F, 0.3F));
  scene.scene.light.sun_irradiance = town.lighting.sun_irradiance;
  scene.scene.light.background = glm::vec3(0.3F, 0.5F, 0.8F);
  return scene;
}

}  // namespace splatbus::bench
