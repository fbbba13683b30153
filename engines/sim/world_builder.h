#pragma once

#include <glm/glm.hpp>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "sim/mesh.h"
#include "sim/scene.h"
#include "sim/world_palette.h"
#include "sim/world_plan.h"

namespace splatbus::sim {

/// Collects the still parts of a world as few objects, each small in space and with one mesh a material, so that what
/// is out of view is left out as a whole. All of them rest in the world's frame.
class WorldBuilder {
 public:
  /// `plan` outlives it.
  explicit WorldBuilder(const WorldPlan& plan);

  /// The object's own frame. `enclosed`: as Object has it.
  void frame(const std::string& object, const glm::mat4& world_from_object, bool enclosed);
  /// Adds to the object of that name.
  void add(const std::string& object, const Mesh& part, const Look& look, const glm::mat4& world_from_part);
  /// Adds to the things of the square of kChunk_m in which the part stands.
  void add(const Mesh& part, const Look& look, const glm::mat4& world_from_part);
  /// Adds to the ground of the square of `place`, in the world's frame.
  void add_at(const Mesh& part, const Look& look, const glm::vec2& place);
  /// The same with the tints that its vertices have.
  void add_tinted(const Mesh& part, const Look& look, const glm::vec2& place);

  /// Whether what is in the circle, on any height, is clear of what took place out of doors and of world_walk().
  [[nodiscard]] bool is_free(const glm::vec2& middle, float radius_m) const;
  void take(const glm::vec2& middle, float radius_m);

  /// The scene with all that was added.
  [[nodiscard]] Scene finish();

  static constexpr float kChunk_m = 16;

 private:
  static std::string square(const glm::vec2& place);

  Scene scene;
  struct Growing {
    std::map<int, Mesh> meshes;  ///< by material, in the world's frame
    glm::mat4 world_from_object{1};
    bool enclosed = false;
  };
  std::map<std::string, Growing> objects_;
  std::vector<glm::vec3> taken_;  ///< x, z, radius

 public:
  const WorldPlan& plan;
  Palette palette;
};

/// Adds to one object, in a frame of its own.
struct Site {
  WorldBuilder& builder;
  std::string object;  ///< empty: that of the square
  glm::mat4 world_from_site;

  void add(const Mesh& part, const Look& look, const glm::mat4& site_from_part = glm::mat4(1)) const;
  [[nodiscard]] Site at(const glm::mat4& site_from_inner) const;
  [[nodiscard]] const Palette& palette() const { return builder.palette; }
};

[[nodiscard]] glm::mat4 moved(const glm::vec3& by);
[[nodiscard]] glm::mat4 moved(const glm::vec3& by, float yaw);

/// from, from + step, ... below `to`, each the sum of the one before and the step.
[[nodiscard]] std::vector<float> spaced(float from, float to, float step);

// Meshes with texture coordinates in metres.

/// A flat or bent quadrangle, corners counter-clockwise as seen from its front, in cells of about `cell_m`. Two corners
/// may be one.
[[nodiscard]] Mesh patch(const glm::vec3& a, const glm::vec3& b, const glm::vec3& c, const glm::vec3& d,
                         float cell_m = 1.2F);
/// A rectangle of the plane y, facing up or down.
[[nodiscard]] Mesh level_patch(const Rect& rect, float y, bool up);

/// In a wall: along x and up y, metres.
struct Opening {
  float from, to, low, high;
};
struct Wall {
  Mesh front, back, reveals;
};
/// Along x from `from` to `to`, y from `low` to `high`; the front faces +z. Openings are holes through it with reveals.
[[nodiscard]] Wall wall(float from, float to, float low, float high, float thickness,
                        std::span<const Opening> openings);

}  // namespace splatbus::sim
