#include "sim/mesh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/matrix_inverse.hpp>

namespace splatbus::sim {
namespace {

void add_grid(Mesh& mesh, std::uint32_t first, int columns, int rows) {
  const auto at = [&](int column, int row) { return first + static_cast<std::uint32_t>(row * (columns + 1) + column); };
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      add_triangle(mesh, at(column, row), at(column + 1, row), at(column + 1, row + 1));
      add_triangle(mesh, at(column, row), at(column + 1, row + 1), at(column, row + 1));
    }
  }
}

}  // namespace

void add_triangle(Mesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c) {
  const Vertex& va = mesh.vertices[a];
  const Vertex& vb = mesh.vertices[b];
  const Vertex& vc = mesh.vertices[c];
  const glm::vec3 face = glm::cross(vb.position - va.position, vc.position - va.position);
  if (glm::dot(face, face) < 1e-16F) return;
  if (glm::dot(face, va.normal + vb.normal + vc.normal) < 0) std::swap(b, c);
  mesh.indices.insert(mesh.indices.end(), {a, b, c});
}

void Bounds::add(const glm::vec3& point) {
  low = glm::min(low, point);
  high = glm::max(high, point);
}

void Bounds::add(const Bounds& other) {
  if (other.empty()) return;
  add(other.low);
  add(other.high);
}

glm::vec3 Bounds::corner(int index) const {
  return {(index & 1) != 0 ? high.x : low.x, (index & 2) != 0 ? high.y : low.y, (index & 4) != 0 ? high.z : low.z};
}

Bounds bounds_of(const Mesh& mesh) {
  Bounds bounds;
  for (const Vertex& vertex : mesh.vertices) bounds.add(vertex.position);
  return bounds;
}

Bounds transformed(const Bounds& bounds, const glm::mat4& a_from_b) {
  Bounds result;
  if (bounds.empty()) return result;
  for (int i = 0; i < 8; ++i) result.add(glm::vec3(a_from_b * glm::vec4(bounds.corner(i), 1)));
  return result;
}

void append(Mesh& mesh, const Mesh& part, const glm::mat4& mesh_from_part) {
  const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
  const glm::mat3 normal_matrix = glm::inverseTranspose(glm::mat3(mesh_from_part));
  for (const Vertex& vertex : part.vertices) {
    mesh.vertices.push_back({glm::vec3(mesh_from_part * glm::vec4(vertex.position, 1)),
                             glm::normalize(normal_matrix * vertex.normal), vertex.uv, vertex.tint});
  }
  for (const std::uint32_t index : part.indices) mesh.indices.push_back(first + index);
}

Mesh box(const glm::vec3& size, float repeat_per_m) {
  Mesh mesh;
  for (int axis = 0; axis < 3; ++axis) {
    for (const float side : {-1.0F, 1.0F}) {
      glm::vec3 normal{0};
      normal[axis] = side;
      // Upright on the four sides: v runs along world y.
      const glm::vec3 up = axis == 1 ? glm::vec3{0, 0, -side} : glm::vec3{0, 1, 0};
      const glm::vec3 right = glm::cross(up, normal);
      const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
      for (const glm::vec2 corner : {glm::vec2{0, 0}, {1, 0}, {1, 1}, {0, 1}}) {
        const glm::vec3 unit = normal + right * (2 * corner.x - 1) + up * (2 * corner.y - 1);
        glm::vec2 uv{corner.x, 1 - corner.y};
        if (repeat_per_m > 0) {
          uv *= repeat_per_m * glm::vec2{glm::dot(glm::abs(right), size), glm::dot(glm::abs(up), size)};
        }
        mesh.vertices.push_back({0.5F * unit * size, normal, uv});
      }
      add_triangle(mesh, first, first + 1, first + 2);
      add_triangle(mesh, first, first + 2, first + 3);
    }
  }
  return mesh;
}

Mesh lathe(std::span<const glm::vec2> profile, int segments, float repeat) {
  Mesh mesh;
  const float crease_cosine = std::cos(glm::radians(30.0F));
  float total = 0;
  for (std::size_t i = 1; i < profile.size(); ++i) total += glm::length(profile[i] - profile[i - 1]);
  const auto edge_normal = [&](std::size_t edge) {
    const glm::vec2 along = glm::normalize(profile[edge + 1] - profile[edge]);
    return glm::vec2{along.y, -along.x};
  };
  float travelled = 0;
  for (std::size_t edge = 0; edge + 1 < profile.size(); ++edge) {
    const glm::vec2 normal = edge_normal(edge);
    const auto smoothed = [&](bool has_neighbour, std::size_t neighbour) {
      if (!has_neighbour) return normal;
      const glm::vec2 other = edge_normal(neighbour);
      return glm::dot(normal, other) > crease_cosine ? glm::normalize(normal + other) : normal;
    };
    const glm::vec2 low_normal = smoothed(edge > 0, edge - 1);
    const glm::vec2 high_normal = smoothed(edge + 2 < profile.size(), edge + 1);
    const float length = glm::length(profile[edge + 1] - profile[edge]);
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    for (int end = 0; end < 2; ++end) {
      const glm::vec2 point = profile[edge + static_cast<std::size_t>(end)];
      const glm::vec2 point_normal = end == 0 ? low_normal : high_normal;
      const float v = 1 - (travelled + (end == 0 ? 0 : length)) / total;
      for (int i = 0; i <= segments; ++i) {
        const float turn = static_cast<float>(i) / static_cast<float>(segments);
        const float angle = turn * glm::two_pi<float>();
        const glm::vec3 out{std::cos(angle), 0, -std::sin(angle)};
        mesh.vertices.push_back({out * point.x + glm::vec3{0, point.y, 0},
                                 glm::normalize(out * point_normal.x + glm::vec3{0, point_normal.y, 0}),
                                 {turn * repeat, v}});
      }
    }
    add_grid(mesh, first, segments, 1);
    travelled += length;
  }
  return mesh;
}

Mesh sphere(float radius, int segments, float repeat) {
  return capsule(radius, 0, segments, repeat);
}

Mesh cylinder(float radius, float height, int segments, float repeat) {
  return lathe(std::array<glm::vec2, 4>{{{0, 0}, {radius, 0}, {radius, height}, {0, height}}}, segments, repeat);
}

Mesh cone(float radius, float height, int segments, float repeat) {
  return lathe(std::array<glm::vec2, 3>{{{0, 0}, {radius, 0}, {0, height}}}, segments, repeat);
}

Mesh capsule(float radius, float length, int segments, float repeat) {
  const int half = std::max(segments / 4, 2);
  std::vector<glm::vec2> profile;
  for (const float side : {-1.0F, 1.0F}) {
    for (int i = 0; i <= half; ++i) {
      if (length <= 0 && side > 0 && i == 0) continue;
      const float step = static_cast<float>(i) / static_cast<float>(half);
      const float angle = glm::half_pi<float>() * (side < 0 ? step - 1 : step);
      profile.emplace_back(std::max(radius * std::cos(angle), 0.0F), radius * std::sin(angle) + side * length / 2);
    }
  }
  profile.front().x = 0;
  profile.back().x = 0;
  return lathe(profile, segments, repeat);
}

Mesh torus(float ring_radius, float tube_radius, int segments, int tube_segments, float repeat) {
  Mesh mesh;
  for (int row = 0; row <= tube_segments; ++row) {
    const float v = static_cast<float>(row) / static_cast<float>(tube_segments);
    const float tube = v * glm::two_pi<float>();
    for (int column = 0; column <= segments; ++column) {
      const float u = static_cast<float>(column) / static_cast<float>(segments);
      const float ring = u * glm::two_pi<float>();
      const glm::vec3 out{std::cos(ring), 0, -std::sin(ring)};
      const glm::vec3 normal = out * std::cos(tube) + glm::vec3{0, std::sin(tube), 0};
      mesh.vertices.push_back({out * ring_radius + normal * tube_radius, normal, {u * repeat, v}});
    }
  }
  add_grid(mesh, 0, segments, tube_segments);
  return mesh;
}

Mesh pyramid(float base, float height) {
  Mesh mesh;
  const float half = base / 2;
  const std::array<glm::vec3, 4> corners{{{half, 0, half}, {half, 0, -half}, {-half, 0, -half}, {-half, 0, half}}};
  const glm::vec3 top{0, height, 0};
  for (std::size_t i = 0; i < 4; ++i) {
    const glm::vec3 a = corners.at(i);
    const glm::vec3 b = corners.at((i + 1) % 4);
    const glm::vec3 normal = glm::normalize(glm::cross(b - a, top - a));
    const auto first = static_cast<std::uint32_t>(mesh.vertices.size());
    mesh.vertices.push_back({a, normal, {0, 1}});
    mesh.vertices.push_back({b, normal, {1, 1}});
    mesh.vertices.push_back({top, normal, {0.5F, 0}});
    add_triangle(mesh, first, first + 1, first + 2);
  }
  return mesh;
}

}  // namespace splatbus::sim
