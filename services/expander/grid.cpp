#include "expander/grid.h"

#include <algorithm>
#include <cmath>

namespace splatbus::expander {

namespace {

template <class Test>
bool any_neighbour(CellId cell, const Test& test) {
  for (int dx = -1; dx <= 1; ++dx) {
    for (int dy = -1; dy <= 1; ++dy) {
      for (int dz = -1; dz <= 1; ++dz) {
        const auto id = neighbour(cell, dx, dy, dz);
        if (id && test(*id)) return true;
      }
    }
  }
  return false;
}

}  // namespace

Grid::PlacedByCell Grid::place(const InputSamples& samples, const std::vector<bool>& seen,
                               const glm::vec3& viewer) const {
  ObjectTransforms object_from_world;
  for (const auto& [id, world_from_object] : samples.objects) object_from_world.emplace(id, inverse(world_from_object));
  PlacedByCell placed;
  for (std::uint32_t i = 0; i < samples.size(); ++i) {
    if (!seen[i] || glm::distance(samples.position[i], viewer) > options_.candidate_radius_m) continue;
    Placed sample{.sample = i, .position = samples.position[i], .normal = samples.normal[i]};
    Frame frame;
    if (const auto object = object_from_world.find(samples.object_id[i]); object != object_from_world.end()) {
      frame = {.local = true, .object_id = samples.object_id[i]};
      sample.position = object->second * sample.position;
      sample.normal = object->second.rotation * sample.normal;
    }
    if (const auto cell = cell_at(sample.position, frame, options_.cell_size_m)) placed[*cell].push_back(sample);
  }
  return placed;
}

bool Grid::is_seen(CellId cell, const PlacedByCell& placed) const {
  const auto enough = [&](CellId id) {
    const auto found = placed.find(id);
    return found != placed.end() && found->second.size() >= static_cast<std::size_t>(options_.min_samples);
  };
  // A surface that only cuts a cell's corner leaves few samples there; what lies alone is no surface.
  return enough(cell) || any_neighbour(cell, enough);
}

bool Grid::covered(CellId cell, const glm::vec3& position, const glm::vec3& normal, float distance_m) const {
  const auto covers = [&](const Cell::Point& point) {
    const glm::vec3 offset = point.position - position;
    return glm::dot(offset, offset) < distance_m * distance_m && glm::dot(point.normal, normal) > kSameSurfaceCosine;
  };
  // Which neighbours the sphere about the position reaches into.
  const glm::vec3 within = position - cell_centre(cell, options_.cell_size_m);
  const float inner = 0.5F * options_.cell_size_m - distance_m;
  const glm::ivec3 low(glm::lessThan(within, glm::vec3(-inner)));
  const glm::ivec3 high(glm::greaterThan(within, glm::vec3(inner)));
  for (int dx = -low.x; dx <= high.x; ++dx) {
    for (int dy = -low.y; dy <= high.y; ++dy) {
      for (int dz = -low.z; dz <= high.z; ++dz) {
        const auto id = neighbour(cell, dx, dy, dz);
        const auto found = id ? cells_.find(*id) : cells_.end();
        if (found == cells_.end()) continue;
        if (std::any_of(found->second.points.begin(), found->second.points.end(), covers)) return true;
      }
    }
  }
  return false;
}

std::vector<Chosen> Grid::choose(const InputSamples& samples, const std::vector<bool>& seen, const glm::vec3& viewer,
                                 std::size_t room) {
  const PlacedByCell placed = place(samples, seen, viewer);
  std::vector<Chosen> chosen;
  for (const auto& [id, in_cell] : placed) {
    if (!is_seen(id, placed)) continue;
    const auto known = cells_.find(id);
    const std::size_t modelled = known == cells_.end() ? 0 : known->second.points.size();
    const float distance = modelled == 0 ? options_.new_distance : options_.top_up_distance;
    const std::size_t before = chosen.size();
    for (const Placed& sample : in_cell) {
      const float apart = std::min(distance * samples.spacing_m[sample.sample], options_.cell_size_m);
      if (covered(id, sample.position, sample.normal, apart)) continue;
      chosen.push_back({.sample = sample.sample, .cell = id, .position = sample.position, .normal = sample.normal});
    }
    const auto worth = static_cast<std::size_t>(std::ceil(options_.top_up_fraction * static_cast<float>(modelled)));
    if (chosen.size() - before < worth) chosen.resize(before);
  }
  // The map's order is none; the round's order keeps neighbours together and the same from run to run.
  std::sort(chosen.begin(), chosen.end(), [](const Chosen& a, const Chosen& b) { return a.sample < b.sample; });
  if (chosen.size() > room) chosen.resize(room);

  for (const auto& [id, in_cell] : placed) cells_[id].samples = static_cast<std::uint32_t>(in_cell.size());
  for (const Chosen& sample : chosen) cells_[sample.cell].points.push_back({sample.position, sample.normal});
  points_ += chosen.size();
  return chosen;
}

void Grid::add_modelled(const Frame& frame, const glm::vec3& position, const glm::vec3& normal) {
  const auto cell = cell_at(position, frame, options_.cell_size_m);
  if (!cell) return;
  cells_[*cell].points.push_back({position, normal});
  ++points_;
}

bool Grid::contains(const Frame& frame, const glm::vec3& position) const {
  const auto cell = cell_at(position, frame, options_.cell_size_m);
  const auto found = cell ? cells_.find(*cell) : cells_.end();
  if (found == cells_.end()) return false;
  const std::vector<Cell::Point>& points = found->second.points;
  return std::any_of(points.begin(), points.end(),
                     [&](const Cell::Point& point) { return point.position == position; });
}

void Grid::clear() {
  cells_.clear();
  points_ = 0;
}

void Grid::set_options(const GridOptions& options) {
  const float cell_size_m = options_.cell_size_m;
  options_ = options;
  options_.cell_size_m = cell_size_m;
}

std::size_t Grid::seen_cells() const {
  return static_cast<std::size_t>(
      std::count_if(cells_.begin(), cells_.end(), [](const auto& entry) { return entry.second.samples > 0; }));
}

std::size_t Grid::modelled_cells() const {
  return static_cast<std::size_t>(
      std::count_if(cells_.begin(), cells_.end(), [](const auto& entry) { return !entry.second.points.empty(); }));
}

}  // namespace splatbus::expander
