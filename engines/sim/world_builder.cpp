#include "sim/world_builder.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/matrix_inverse.hpp>
#include <glm/gtc/matrix_transform.hpp>
#include <utility>
#include <vector>

#include "sim/paint.h"
#include "sim/world.h"

namespace splatbus::sim {
namespace {

constexpr float kCell_m = 1.2F;

/// Ends, openings' edges, and points between them at most kCell_m apart.
std::vector<float> breaks(float from, float to, std::vector<float> at) {
  at.push_back(from);
  at.push_back(to);
  std::erase_if(at, [&](float x) { return x < from || x > to; });
  std::ranges::sort(at);
  std::vector<float> result{at.front()};
  for (std::size_t i = 1; i < at.size(); ++i) {
    const float gap = at[i] - at[i - 1];
    if (gap < 1e-4F) continue;
    const int parts = std::max(1, static_cast<int>(std::ceil(gap / kCell_m)));
    for (int k = 1; k <= parts; ++k)
      result.push_back(at[i - 1] + gap * static_cast<float>(k) / static_cast<float>(parts));
  }
  return result;
}

glm::u8vec4 byte_tint(const glm::vec3& tint) {
  return {glm::clamp(tint, 0.0F, 1.0F) * 255.0F + 0.5F, 255};
}

}  // namespace

WorldBuilder::WorldBuilder(const WorldPlan& the_plan) : plan(the_plan), palette(scene, the_plan.seed) {
  constexpr float kWalker_m = 0.35F;
  for (const glm::vec3& eye : world_walk(plan.seed)) take({eye.x, eye.z}, kWalker_m);
}

void WorldBuilder::frame(const std::string& object, const glm::mat4& world_from_object, bool enclosed) {
  Growing& growing = objects_[object];
  growing.world_from_object = world_from_object;
  growing.enclosed = enclosed;
}

bool WorldBuilder::is_free(const glm::vec2& middle, float radius_m) const {
  return std::ranges::none_of(
      taken_, [&](const glm::vec3& other) { return glm::distance(middle, glm::vec2(other)) < radius_m + other.z; });
}

void WorldBuilder::take(const glm::vec2& middle, float radius_m) {
  taken_.emplace_back(middle, radius_m);
}

std::string WorldBuilder::square(const glm::vec2& place) {
  const auto index = [](float x) { return static_cast<int>(std::floor((x + WorldPlan::kHalf_m) / kChunk_m)); };
  return fmt::format("{} {}", index(place.x), index(place.y));
}

void WorldBuilder::add(const std::string& object, const Mesh& part, const Look& look,
                       const glm::mat4& world_from_part) {
  Mesh& mesh = objects_[object].meshes[look.material];
  const std::size_t first = mesh.vertices.size();
  append(mesh, part, world_from_part);
  for (std::size_t i = first; i < mesh.vertices.size(); ++i) {
    Vertex& vertex = mesh.vertices[i];
    vertex.uv = look.repeat_per_m * vertex.uv + look.shift;
    const glm::vec3 p = vertex.position;
    const float weather = noise(plan.seed, glm::vec2(p.x + 0.8F * p.z, 1.3F * p.y + 0.6F * p.z) + 300.0F, {2048, 2048});
    vertex.tint = byte_tint(look.tint * (1 + look.uneven * (2 * weather - 1)));
  }
}

void WorldBuilder::add(const Mesh& part, const Look& look, const glm::mat4& world_from_part) {
  const std::string object = "things " + square({world_from_part[3].x, world_from_part[3].z});
  objects_[object].enclosed = true;  // by houses, for who is in a street
  add(object, part, look, world_from_part);
}

void WorldBuilder::add_at(const Mesh& part, const Look& look, const glm::vec2& place) {
  add("ground " + square(place), part, look, glm::mat4(1));
}

void WorldBuilder::add_tinted(const Mesh& part, const Look& look, const glm::vec2& place) {
  Mesh& mesh = objects_["ground " + square(place)].meshes[look.material];
  const std::size_t first = mesh.vertices.size();
  append(mesh, part);
  for (std::size_t i = first; i < mesh.vertices.size(); ++i)
    mesh.vertices[i].uv = look.repeat_per_m * mesh.vertices[i].uv + look.shift;
}

Scene WorldBuilder::finish() {
  for (auto& [name, growing] : objects_) {
    Object object;
    object.id = static_cast<std::uint32_t>(scene.objects.size() + 1);
    object.name = name;
    object.world_from_object = growing.world_from_object;
    object.enclosed = growing.enclosed;
    const bool framed = growing.world_from_object != glm::mat4(1);
    for (auto& [material, mesh] : growing.meshes) {
      Part part{.mesh = {}, .material = material};
      if (framed)
        append(part.mesh, mesh, glm::inverse(growing.world_from_object));
      else
        part.mesh = std::move(mesh);
      object.parts.push_back(std::move(part));
    }
    scene.objects.push_back(std::move(object));
  }
  objects_.clear();
  return std::move(scene);
}

void Site::add(const Mesh& part, const Look& look, const glm::mat4& site_from_part) const {
  if (object.empty()) return builder.add(part, look, world_from_site * site_from_part);
  builder.add(object, part, look, world_from_site * site_from_part);
}

Site Site::at(const glm::mat4& site_from_inner) const {
  return {builder, object, world_from_site * site_from_inner};
}

glm::mat4 moved(const glm::vec3& by) {
  return glm::translate(glm::mat4(1), by);
}

glm::mat4 moved(const glm::vec3& by, float yaw) {
  return glm::rotate(moved(by), yaw, glm::vec3(0, 1, 0));
}

std::vector<float> spaced(float from, float to, float step) {
  std::vector<float> places;
  while (from < to) {
    places.push_back(from);
    from += step;
  }
  return places;
}

Mesh patch(const glm::vec3& a, const glm::vec3& b, const glm::vec3& c, const glm::vec3& d, float cell_m) {
  const float width = std::max(glm::distance(a, b), glm::distance(d, c));
  const float height = std::max(glm::distance(a, d), glm::distance(b, c));
  const int columns = std::max(1, static_cast<int>(std::ceil(width / cell_m)));
  const int rows = std::max(1, static_cast<int>(std::ceil(height / cell_m)));
  const glm::vec3 normal = glm::normalize(glm::cross(c - a, d - b));
  Mesh mesh;
  for (int row = 0; row <= rows; ++row) {
    for (int column = 0; column <= columns; ++column) {
      const float u = static_cast<float>(column) / static_cast<float>(columns);
      const float v = static_cast<float>(row) / static_cast<float>(rows);
      const glm::vec3 low = glm::mix(a, b, u), high = glm::mix(d, c, u);
      const glm::vec3 along = b == a ? c - d : b - a;
      const glm::vec3 p = glm::mix(low, high, v);
      mesh.vertices.push_back({p, normal, {glm::dot(p - a, glm::normalize(along)), (1 - v) * height}});
    }
  }
  const auto at = [&](int column, int row) { return static_cast<std::uint32_t>(row * (columns + 1) + column); };
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      add_triangle(mesh, at(column, row), at(column + 1, row), at(column + 1, row + 1));
      add_triangle(mesh, at(column, row), at(column + 1, row + 1), at(column, row + 1));
    }
  }
  return mesh;
}

Mesh level_patch(const Rect& rect, float y, bool up) {
  const glm::vec3 a{rect.low.x, y, rect.high.y}, b{rect.high.x, y, rect.high.y};
  const glm::vec3 c{rect.high.x, y, rect.low.y}, d{rect.low.x, y, rect.low.y};
  return up ? patch(a, b, c, d, 2) : patch(d, c, b, a, 2);
}

Wall wall(float from, float to, float low, float high, float thickness, std::span<const Opening> openings) {
  std::vector<float> xs, ys;
  for (const Opening& opening : openings) {
    xs.insert(xs.end(), {opening.from, opening.to});
    ys.insert(ys.end(), {opening.low, opening.high});
  }
  const std::vector<float> x = breaks(from, to, xs), y = breaks(low, high, ys);
  const auto solid = [&](std::size_t i, std::size_t j) {
    const float mx = (x[i] + x[i + 1]) / 2, my = (y[j] + y[j + 1]) / 2;
    return std::ranges::none_of(
        openings, [&](const Opening& o) { return mx > o.from && mx < o.to && my > o.low && my < o.high; });
  };
  const float z = thickness / 2;
  Wall result;
  const auto quad = [](Mesh& mesh, const glm::vec3& normal, const glm::vec3(&corners)[4], const glm::vec2& u,
                       const glm::vec2& v) {
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.push_back({corners[0], normal, {u.x, v.x}});
    mesh.vertices.push_back({corners[1], normal, {u.y, v.x}});
    mesh.vertices.push_back({corners[2], normal, {u.y, v.y}});
    mesh.vertices.push_back({corners[3], normal, {u.x, v.y}});
    add_triangle(mesh, first, first + 1, first + 2);
    add_triangle(mesh, first, first + 2, first + 3);
  };
  /// Upright across the wall at x, between its faces.
  const auto across_x = [&](Mesh& mesh, float at, float normal, std::size_t j) {
    quad(mesh, {normal, 0, 0}, {{at, y[j], -z}, {at, y[j], z}, {at, y[j + 1], z}, {at, y[j + 1], -z}}, {-z, z},
         {-y[j], -y[j + 1]});
  };
  const auto across_y = [&](Mesh& mesh, float at, float normal, std::size_t i) {
    quad(mesh, {0, normal, 0}, {{x[i], at, -z}, {x[i + 1], at, -z}, {x[i + 1], at, z}, {x[i], at, z}}, {x[i], x[i + 1]},
         {-z, z});
  };
  for (std::size_t i = 0; i + 1 < x.size(); ++i) {
    for (std::size_t j = 0; j + 1 < y.size(); ++j) {
      const bool here = solid(i, j);
      if (here) {
        for (const float side : {z, -z}) {
          quad(side > 0 ? result.front : result.back, {0, 0, side > 0 ? 1 : -1},
               {{x[i], y[j], side}, {x[i + 1], y[j], side}, {x[i + 1], y[j + 1], side}, {x[i], y[j + 1], side}},
               {x[i], x[i + 1]}, {-y[j], -y[j + 1]});
        }
        if (i == 0) across_x(result.front, x[i], -1, j);
        if (i + 2 == x.size()) across_x(result.front, x[i + 1], 1, j);
      }
      if (i + 2 < x.size() && here != solid(i + 1, j)) across_x(result.reveals, x[i + 1], here ? 1.0F : -1.0F, j);
      if (j + 2 < y.size() && here != solid(i, j + 1)) across_y(result.reveals, y[j + 1], here ? 1.0F : -1.0F, i);
    }
  }
  return result;
}

}  // namespace splatbus::sim
