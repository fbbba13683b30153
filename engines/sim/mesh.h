#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <glm/gtc/type_precision.hpp>
#include <span>
#include <vector>

namespace splatbus::sim {

struct Vertex {
  glm::vec3 position;
  glm::vec3 normal;  ///< unit, towards the outside
  glm::vec2 uv;
  glm::u8vec4 tint{255};  ///< of the linear albedo, 255 for 1; alpha does not count
};

/// Triangles, counter-clockwise as seen from outside.
struct Mesh {
  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices;
};

/// Axis-aligned box; empty until something was added.
struct Bounds {
  glm::vec3 low{1e30F};
  glm::vec3 high{-1e30F};

  [[nodiscard]] bool empty() const { return low.x > high.x; }
  void add(const glm::vec3& point);
  void add(const Bounds& other);
  [[nodiscard]] glm::vec3 corner(int index) const;  ///< index 0..7
};

[[nodiscard]] Bounds bounds_of(const Mesh& mesh);
[[nodiscard]] Bounds transformed(const Bounds& bounds, const glm::mat4& a_from_b);

/// Adds `part`, transformed, to `mesh`.
void append(Mesh& mesh, const Mesh& part, const glm::mat4& mesh_from_part = glm::mat4(1));

/// Adds the triangle so that it faces where the normals of its corners point; none when it has no area.
void add_triangle(Mesh& mesh, std::uint32_t a, std::uint32_t b, std::uint32_t c);

/// Six faces of `size` metres about the origin. Every face shows the whole texture `repeat_per_m` times a metre, or
/// once when that is 0.
[[nodiscard]] Mesh box(const glm::vec3& size, float repeat_per_m = 0);

/// Surface of revolution about y. `profile` is (radius, height) from the bottom to the top, outside to its right; where
/// it bends by more than 30 degrees there is a crease. v runs along the profile, u `repeat` times around.
[[nodiscard]] Mesh lathe(std::span<const glm::vec2> profile, int segments, float repeat = 1);

[[nodiscard]] Mesh sphere(float radius, int segments, float repeat = 1);
[[nodiscard]] Mesh cylinder(float radius, float height, int segments, float repeat = 1);  ///< stands on y = 0
[[nodiscard]] Mesh cone(float radius, float height, int segments, float repeat = 1);      ///< stands on y = 0
[[nodiscard]] Mesh capsule(float radius, float length, int segments, float repeat = 1);   ///< along y, centred
[[nodiscard]] Mesh torus(float ring_radius, float tube_radius, int segments, int tube_segments, float repeat = 1);
[[nodiscard]] Mesh pyramid(float base, float height);  ///< square, stands on y = 0

}  // namespace splatbus::sim
