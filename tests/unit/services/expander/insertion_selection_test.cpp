// Selection of samples beside its rules, written in the plainest way.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <tuple>
#include <utility>
#include <vector>

#include "insertion_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

/// The rules of selection in the plainest way, every sample beside every point, for what stands still.
class PlainSelection {
 public:
  explicit PlainSelection(const SelectOptions& options) : options_(options) {}

  std::vector<glm::vec3> insert(const HostRound& round, const std::vector<Viewpoint>& viewpoints) {
    std::map<Cell, std::size_t> samples;
    const auto candidate = [&](std::size_t i) {
      return std::any_of(viewpoints.begin(), viewpoints.end(), [&](const Viewpoint& viewpoint) {
        const float distance_m = glm::distance(
            round.position[i], glm::vec3(viewpoint.position.x, viewpoint.position.y, viewpoint.position.z));
        return distance_m <= options_.reach_m ||
               round.spacing_m[i] * viewpoint.focal_px / distance_m >= options_.min_pixels;
      });
    };
    for (std::size_t i = 0; i < round.size(); ++i) {
      if (candidate(i)) ++samples[cell_of(round.position[i], round.spacing_m[i])];
    }
    std::map<Cell, std::size_t> uncovered;
    std::set<Cell> holes;
    std::vector<float> nearest(round.size(), 0);  // of the spacing; 0: is none that matters
    for (std::size_t i = 0; i < round.size(); ++i) {
      const Cell cell = cell_of(round.position[i], round.spacing_m[i]);
      if (!candidate(i) || !seen(cell, samples)) continue;
      nearest[i] = nearest_point(round, i);
      if (nearest[i] >= options_.new_distance) ++uncovered[cell];
      if (nearest[i] >= std::max(options_.hole_distance, options_.new_distance)) holes.insert(cell);
    }
    std::vector<std::size_t> selected;
    for (std::size_t i = 0; i < round.size() && selected.size() < options_.room; ++i) {
      if (nearest[i] < std::min(options_.fill_distance, options_.new_distance)) continue;
      const Cell cell = cell_of(round.position[i], round.spacing_m[i]);
      const auto of_cell = static_cast<float>(samples[cell]);
      const bool refine = (uncovered[cell] >= options_.min_samples &&
                           static_cast<float>(uncovered[cell]) >= options_.refine_share * of_cell) ||
                          any_beside(cell, holes);
      if (refine || nearest[i] >= options_.hole_distance) selected.push_back(i);
    }
    std::vector<glm::vec3> positions;
    for (const std::size_t i : selected) {
      positions.push_back(round.position[i]);
      points_.emplace_back(round.position[i], round.normal[i]);
    }
    return positions;
  }

 private:
  using Cell = std::tuple<float, float, float, float>;  // edge, coordinates

  /// Of the smallest that are at least three spacings wide, by halves and doubles of kCellSize_m, down to an eighth.
  [[nodiscard]] Cell cell_of(const glm::vec3& p, float spacing_m) const {
    float edge_m = kCellSize_m / 8;
    const float factor = std::max({3.0F, options_.new_distance, options_.hole_distance});
    while (edge_m < factor * spacing_m) edge_m *= 2;
    const glm::vec3 at = glm::floor((p + 0.5F * kCellSize_m) / edge_m);
    return {edge_m, at.x, at.y, at.z};
  }
  [[nodiscard]] static bool any_beside(const Cell& cell, const std::set<Cell>& others) {
    const auto [edge_m, x, y, z] = cell;
    for (int k = 0; k < 27; ++k) {
      if (others.contains({edge_m, x + static_cast<float>(k / 9 - 1), y + static_cast<float>(k / 3 % 3 - 1),
                           z + static_cast<float>(k % 3 - 1)})) {
        return true;
      }
    }
    return false;
  }
  [[nodiscard]] bool seen(const Cell& cell, const std::map<Cell, std::size_t>& samples) const {
    const auto [edge_m, x, y, z] = cell;
    std::size_t about = 0;
    for (const auto& [other, count] : samples) {
      const auto [its_edge_m, its_x, its_y, its_z] = other;
      const glm::vec3 here(x, y, z), there(its_x, its_y, its_z);
      const glm::vec3 apart = glm::abs(here - (its_edge_m < edge_m ? glm::floor(there / 2.0F) : there));
      const bool beside =
          std::max({apart.x, apart.y, apart.z}) <= 1 && (its_edge_m == edge_m || its_edge_m == edge_m / 2);
      const bool about_it = its_edge_m == 2 * edge_m && glm::floor(here / 2.0F) == there;
      if (beside || about_it) about += count;
    }
    return about >= options_.min_samples;
  }
  [[nodiscard]] float nearest_point(const HostRound& round, std::size_t i) const {
    float nearest = INFINITY;
    for (const auto& [point, normal] : points_) {
      if (glm::dot(normal, round.normal[i]) <= 0.5F) continue;
      nearest = std::min(nearest, glm::distance(point, round.position[i]) / round.spacing_m[i]);
    }
    return nearest;
  }

  SelectOptions options_;
  std::vector<std::pair<glm::vec3, glm::vec3>> points_;
};

TEST_P(InsertionTest, SelectsWhatThePlainRulesSelect) {
  const RoomScene scene;
  const auto still = [&](std::uint32_t cameras, std::uint32_t size, float turn) {
    HostRound round = room_round(scene, cameras, size, turn);
    round.scene.objects.clear();
    return round;
  };
  viewpoints_ = {{.position = {1, 1, 1}, .ahead = {1, 1, 1}, .focal_px = 60}};
  for (const SelectOptions& options :
       {SelectOptions{}, SelectOptions{.reach_m = 2, .min_pixels = 1.5F, .room = 4000},
        SelectOptions{.min_samples = 20, .new_distance = 0.5F, .hole_distance = 2, .refine_share = 0.5F},
        SelectOptions{.new_distance = 2, .fill_distance = 1.5F, .hole_distance = 4.5F, .refine_share = 0.1F}}) {
    use_cells_of(kCellSize_m);
    options_.select = options;
    options_.select.refine_factor = 1e6F;  // FilledCells has tests of its own
    PlainSelection plain(options);
    for (const HostRound& round : {still(4, 40, 0), still(5, 48, 0.3F), still(3, 40, 0.9F)}) {
      const auto expected = plain.insert(round, viewpoints_);
      EXPECT_EQ(insert(round).mean, expected);
      EXPECT_GT(expected.size(), 10U);
    }
  }
}

}  // namespace
}  // namespace splatbus::expander::test
