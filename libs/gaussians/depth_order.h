#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <vector>

namespace splatbus {

/// The order in which rows of Gaussians are drawn: by the depth of their means, farthest first. Rows lie in objects
/// that move. A counting sort by the depth's 16 leading bits between the nearest and the farthest: their step is at
/// most a 4096th of the depth within a range of 16 octaves. Not thread-safe.
class DepthOrder {
 public:
  /// world_from_object, row-major [3][4]; all zero hides what is in it.
  using Transform = std::array<float, 12>;
  static constexpr std::uint32_t kHidden = 0xFFFFFFFFU;

  /// Rows above are hidden until they are placed.
  void resize(std::size_t rows);
  [[nodiscard]] std::size_t rows() const { return places_.size(); }
  /// `mean` in the frame of its object.
  void place(std::uint32_t row, const glm::vec3& mean, std::uint32_t object) { places_[row] = {mean, object}; }
  void hide(std::uint32_t row) { places_[row].object = kHidden; }
  /// By the index of objects. `far_field`: one that goes with the eye, whose transform is for an eye in the origin; 0:
  /// there is none.
  void set_transforms(std::span<const Transform> transforms, std::uint32_t far_field);

  /// Rows beyond the near plane, farthest first; where depths are alike, by row. depth = dot(view_z, (point_world, 1)),
  /// metres. Valid until the next call.
  [[nodiscard]] std::span<const std::uint32_t> sort(const std::array<float, 4>& view_z, float near_m = 0.05F);

 private:
  struct Place {
    glm::vec3 mean{0};
    std::uint32_t object = kHidden;
  };
  struct Plane {
    glm::vec3 normal{0};
    float offset = 0;
  };

  std::vector<Place> places_;
  std::vector<Transform> transforms_{Transform{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
  std::uint32_t far_field_ = 0;
  std::vector<Plane> planes_;        ///< view_z in each object's frame
  std::vector<std::uint32_t> keys_;  ///< [rows]
  std::vector<std::uint32_t> counts_;
  std::vector<std::uint32_t> order_;
};

}  // namespace splatbus
