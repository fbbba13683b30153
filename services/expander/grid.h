#pragma once

#include <cstdint>
#include <glm/glm.hpp>
#include <span>
#include <unordered_map>
#include <vector>

#include "expander/cell.h"
#include "expander/input_samples.h"

namespace splatbus::expander {

struct GridOptions {
  float cell_size_m = 0.25F;
  float candidate_radius_m = 12;  ///< broad phase: cells within this distance of the viewer
  int min_samples = 4;            ///< a cell counts as seen with this many, or with fewer beside a cell that has them
  float new_distance = 0.5F;  ///< of a sample's spacing: how near to modelled neighbours a new cell's samples may come
  float top_up_distance =
      0.75F;  ///< the same in cells that are modelled; a full square grid leaves nothing beyond 0.71
  float top_up_fraction = 0.02F;  ///< a modelled cell is topped up when this share of what it holds is new
};

inline constexpr float kSameSurfaceCosine = 0.5F;  ///< between normals of points that can cover one another

/// A sample that is to become a Gaussian.
struct Chosen {
  std::uint32_t sample;  ///< index into the round
  CellId cell;
  glm::vec3 position, normal;  ///< in the sample's frame
};

/// What the grid holds of one cell.
struct Cell {
  struct Point {
    glm::vec3 position, normal;
  };
  std::uint32_t samples = 0;  ///< seen in the last round that saw it
  std::vector<Point> points;  ///< modelled, in the cell's frame
};

/// A regular grid over the world and over every moving object: which cells are seen, which are modelled, and by what.
/// Not thread-safe.
class Grid {
 public:
  explicit Grid(const GridOptions& options) : options_(options) {}

  /// The samples of a round that the model lacks: those of cells that are candidates, seen, and either not modelled yet
  /// or modelled clearly less than they are seen now. `seen` is a flag a sample; at most `room` are chosen. Remembers
  /// them as modelled.
  [[nodiscard]] std::vector<Chosen> choose(const InputSamples& samples, const std::vector<bool>& seen,
                                           const glm::vec3& viewer, std::size_t room = SIZE_MAX);

  /// Remembers a point that the model has already, in the frame that its cell says.
  void add_modelled(const Frame& frame, const glm::vec3& position, const glm::vec3& normal);

  /// True when something modelled within `distance_m`, at most the cell size, faces the same way. `cell` holds the
  /// position.
  [[nodiscard]] bool covered(CellId cell, const glm::vec3& position, const glm::vec3& normal, float distance_m) const;

  /// True when exactly that position is modelled in that frame.
  [[nodiscard]] bool contains(const Frame& frame, const glm::vec3& position) const;

  void clear();

  /// All but the cell size, which is fixed.
  void set_options(const GridOptions& options);

  [[nodiscard]] const GridOptions& options() const { return options_; }
  [[nodiscard]] const std::unordered_map<CellId, Cell>& cells() const { return cells_; }
  [[nodiscard]] std::size_t seen_cells() const;
  [[nodiscard]] std::size_t modelled_cells() const;
  [[nodiscard]] std::size_t modelled_points() const { return points_; }

 private:
  struct Placed {
    std::uint32_t sample;
    glm::vec3 position, normal;
  };
  using PlacedByCell = std::unordered_map<CellId, std::vector<Placed>>;

  [[nodiscard]] PlacedByCell place(const InputSamples& samples, const std::vector<bool>& seen,
                                   const glm::vec3& viewer) const;
  [[nodiscard]] bool is_seen(CellId cell, const PlacedByCell& placed) const;

  GridOptions options_;
  std::unordered_map<CellId, Cell> cells_;
  std::size_t points_ = 0;
};

}  // namespace splatbus::expander
