// Selection of samples beside its rules, written in the plainest way.
#include <cmath>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "gaussians/light.h"
#include "insertion_fixture.h"
#include "room_scene.h"

namespace splatbus::expander::test {
namespace {

/// The rules of selection in the plainest way, for what stands still.
class PlainSelection {
 public:
  explicit PlainSelection(const SelectOptions& options) : options_(options) {}

  std::vector<glm::vec3> insert(const HostRound& round) {
    std::map<Cell, std::vector<std::size_t>> by_cell;
    for (std::size_t i = 0; i < round.size(); ++i) {
      const glm::vec3 viewer(options_.viewer.x, options_.viewer.y, options_.viewer.z);
      if (glm::distance(round.position[i], viewer) <= options_.candidate_radius_m) {
        by_cell[cell_of(round.position[i])].push_back(i);
      }
    }
    std::set<std::size_t> selected;
    for (const auto& [cell, samples] : by_cell) {
      if (!seen(cell, by_cell)) continue;
      const std::size_t held = points_[cell].size();
      const float distance = held == 0 ? options_.new_distance : options_.top_up_distance;
      std::vector<std::size_t> lacking;
      for (const std::size_t i : samples) {
        const float apart = std::min(distance * round.spacing_m[i], kCellSize_m);
        if (!covered(cell, round.position[i], round.normal[i], apart)) lacking.push_back(i);
      }
      if (static_cast<float>(lacking.size()) >= std::ceil(options_.top_up_fraction * static_cast<float>(held))) {
        selected.insert(lacking.begin(), lacking.end());
      }
    }
    std::vector<glm::vec3> positions;
    for (const std::size_t i : selected) {
      if (positions.size() == options_.room) break;
      positions.push_back(round.position[i]);
      points_[cell_of(round.position[i])].emplace_back(round.position[i], round.normal[i]);
    }
    return positions;
  }

 private:
  using Cell = std::tuple<int, int, int>;

  static Cell cell_of(const glm::vec3& p) {
    const glm::ivec3 at(glm::floor(p / kCellSize_m + 0.5F));
    return {at.x, at.y, at.z};
  }
  template <class Test>
  static bool any_about(const Cell& cell, const Test& test) {
    const auto [x, y, z] = cell;
    for (int k = 0; k < 27; ++k) {
      if (test(Cell{x + k / 9 - 1, y + k / 3 % 3 - 1, z + k % 3 - 1})) return true;
    }
    return false;
  }
  [[nodiscard]] bool seen(const Cell& cell, const std::map<Cell, std::vector<std::size_t>>& by_cell) const {
    return any_about(cell, [&](const Cell& at) {
      const auto found = by_cell.find(at);
      return found != by_cell.end() && found->second.size() >= options_.min_samples;
    });
  }
  [[nodiscard]] bool covered(const Cell& cell, const glm::vec3& position, const glm::vec3& normal, float apart) const {
    return any_about(cell, [&](const Cell& at) {
      const auto found = points_.find(at);
      if (found == points_.end()) return false;
      for (const auto& [point, its_normal] : found->second) {
        const glm::vec3 offset = point - position;
        if (glm::dot(offset, offset) < apart * apart && glm::dot(its_normal, normal) > 0.5F) return true;
      }
      return false;
    });
  }

  SelectOptions options_;
  std::map<Cell, std::vector<std::pair<glm::vec3, glm::vec3>>> points_;
};

TEST_P(InsertionTest, SelectsWhatThePlainRulesSelect) {
  const RoomScene scene;
  const auto still = [&](std::uint32_t cameras, std::uint32_t size, float turn) {
    HostRound round = room_round(scene, cameras, size, turn);
    round.scene.objects.clear();
    return round;
  };
  for (const SelectOptions& options :
       {SelectOptions{}, SelectOptions{.candidate_radius_m = 3, .viewer = {1, 1, 1}, .room = 4000},
        SelectOptions{.min_samples = 20, .new_distance = 5, .top_up_distance = 8, .top_up_fraction = 0.3F}}) {
    use_cells_of(kCellSize_m);
    options_.select = options;
    PlainSelection plain(options);
    for (const HostRound& round : {still(4, 40, 0), still(5, 48, 0.3F), still(3, 40, 0.9F)}) {
      const auto expected = plain.insert(round);
      EXPECT_EQ(insert(round).mean, expected);
      EXPECT_GT(expected.size(), 10U);
    }
  }
}

}  // namespace
}  // namespace splatbus::expander::test
