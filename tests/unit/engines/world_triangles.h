#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <glm/glm.hpp>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "sim/scene.h"

namespace splatbus::sim {

using Triangle = std::array<glm::vec3, 3>;

/// Calls `visit` with each triangle, in the world, of what rests.
template <class Visit>
void each_still_triangle(const Scene& scene, Visit&& visit) {
  for (const Object& object : scene.objects) {
    if (object.motion) continue;
    for (const Part& part : object.parts) {
      for (std::size_t i = 0; i < part.mesh.indices.size(); i += 3) {
        Triangle triangle;
        for (std::size_t k = 0; k < 3; ++k) {
          triangle.at(k) = glm::vec3(object.world_from_object *
                                     glm::vec4(part.mesh.vertices.at(part.mesh.indices[i + k]).position, 1));
        }
        visit(triangle);
      }
    }
  }
}

/// The point of a triangle nearest to p: Ericson, Real-Time Collision Detection, 5.1.5.
inline glm::vec3 nearest_on(const Triangle& t, const glm::vec3& p) {
  const auto& [a, b, c] = t;
  const glm::vec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const float d1 = glm::dot(ab, ap), d2 = glm::dot(ac, ap), d3 = glm::dot(ab, bp), d4 = glm::dot(ac, bp),
              d5 = glm::dot(ab, cp), d6 = glm::dot(ac, cp);
  if (d1 <= 0 && d2 <= 0) return a;
  if (d3 >= 0 && d4 <= d3) return b;
  if (d6 >= 0 && d5 <= d6) return c;
  const float vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  if (va <= 0 && d4 >= d3 && d5 >= d6) return b + (d4 - d3) / (d4 - d3 + d5 - d6) * (c - b);
  return a + (vb * ab + vc * ac) / (va + vb + vc);
}

/// How far down from p the triangle is, or nothing when it is not under p: Moller and Trumbore 1997, along -y.
inline std::optional<float> below(const Triangle& t, const glm::vec3& p) {
  const glm::vec3 down(0, -1, 0), ab = t[1] - t[0], ac = t[2] - t[0], q = glm::cross(down, ac);
  const float det = glm::dot(ab, q);
  if (std::abs(det) < 1e-9F) return std::nullopt;
  const glm::vec3 from = p - t[0];
  const float u = glm::dot(from, q) / det;
  const glm::vec3 r = glm::cross(from, ab);
  const float v = glm::dot(down, r) / det, away = glm::dot(ac, r) / det;
  constexpr float kSeam = 1e-4F;  // a ray may meet the edge of two triangles
  if (u < -kSeam || v < -kSeam || u + v > 1 + kSeam || away < 0) return std::nullopt;
  return away;
}

/// Points at most 5 cm apart along a polyline.
inline std::vector<glm::vec3> dense(const std::vector<glm::vec3>& line) {
  std::vector<glm::vec3> points{line.front()};
  for (std::size_t i = 1; i < line.size(); ++i) {
    const int steps = std::max(1, static_cast<int>(std::ceil(glm::distance(line[i - 1], line[i]) / 0.05F)));
    for (int k = 1; k <= steps; ++k)
      points.push_back(glm::mix(line[i - 1], line[i], static_cast<float>(k) / static_cast<float>(steps)));
  }
  return points;
}

/// A scene's still triangles about some points, by square of one metre.
class TriangleGrid {
 public:
  TriangleGrid(const Scene& scene, const std::vector<glm::vec3>& points) {
    for (const glm::vec3& p : points) {
      for (int dx = -1; dx <= 1; ++dx) {
        for (int dz = -1; dz <= 1; ++dz) static_cast<void>(squares_[{cell(p.x) + dx, cell(p.z) + dz}]);
      }
    }
    each_still_triangle(scene, [&](const Triangle& triangle) {
      Bounds bounds;
      for (const glm::vec3& corner : triangle) bounds.add(corner);
      for (int x = cell(bounds.low.x); x <= cell(bounds.high.x); ++x) {
        for (int z = cell(bounds.low.z); z <= cell(bounds.high.z); ++z) {
          if (const auto found = squares_.find({x, z}); found != squares_.end()) found->second.push_back(triangle);
        }
      }
    });
  }

  /// From one of the points to the nearest triangle; 1 m at most.
  [[nodiscard]] float clearance(const glm::vec3& p) const {
    float nearest = 1;
    for (int dx = -1; dx <= 1; ++dx) {
      for (int dz = -1; dz <= 1; ++dz) {
        for (const Triangle& t : squares_.at({cell(p.x) + dx, cell(p.z) + dz}))
          nearest = std::min(nearest, glm::distance(p, nearest_on(t, p)));
      }
    }
    return nearest;
  }
  /// How far below one of the points something is.
  [[nodiscard]] float height(const glm::vec3& p) const {
    float nearest = 1e9F;
    for (const Triangle& t : squares_.at({cell(p.x), cell(p.z)}))
      nearest = std::min(nearest, below(t, p).value_or(1e9F));
    return nearest;
  }

 private:
  static int cell(float x) { return static_cast<int>(std::floor(x)); }
  std::map<std::pair<int, int>, std::vector<Triangle>> squares_;
};

}  // namespace splatbus::sim
