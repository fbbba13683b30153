#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "expander/insertion.h"
#include "gaussians/pages.h"

// What is modelled, as points: written once for both devices (point_grid.cu). Pointers are to memory of the stream's
// device unless they are spans. Throws as insertion.h.
namespace splatbus::expander {

/// In the units of its frame, or in a PointGrid in metres of the world.
struct ModelledPoint {
  math::Vec3 position, normal;
};

/// Where somebody's model keeps what is needed of it: GaussiansView's layout. Values may be anything.
struct ModelPages {
  const float *surface_point, *normal;
  std::size_t stride;
  std::uint32_t page_shift;
  std::size_t page_stride;
};

/// A page whose points are to be read.
struct PageRange {
  IndexRange range;
  float metres_per_unit = 1;  ///< of its frame
};

/// Copies the pages' points to `points`, kPageLanes apart, and tells what each page has in its cells of kReportLevel:
/// `[first[i], first[i + 1])` of the result are those of page i, ascending. Points that no cell holds are in none.
struct PageCells {
  std::vector<CellCount> cells;
  std::vector<std::uint32_t> first;
};
[[nodiscard]] PageCells read_pages(device::StreamView stream, const ModelPages& model, std::span<const PageRange> pages,
                                   float cell_size_m, ModelledPoint* points);

/// Points of one frame of reference in its own units.
struct PointBlock {
  const ModelledPoint* points = nullptr;
  std::uint32_t count = 0;
  std::uint32_t frame_id = kWorldFrame;
  float metres_per_unit = 1;
};

/// Cells of a level that hold new Gaussians, ascending.
[[nodiscard]] std::vector<CellCount> cells_of(device::StreamView stream, const InsertChannels& gaussians,
                                              std::span<const ObjectFrame> objects, float cell_size_m, unsigned level);

/// Points in the order of their cells of level 0. Not thread-safe.
class PointGrid {
 public:
  PointGrid(device::StreamView stream, float cell_size_m);

  /// These points and no others; those that no cell holds are left out.
  void assign(std::span<const PointBlock> blocks);
  /// `objects`: ascending by id; what is in the frame of another has its own units for metres.
  void add(std::span<const InsertChannels> batches, std::span<const ObjectFrame> objects);

  /// Whether exactly the position of any of the Gaussians is there, in its frame; of frames in metres.
  [[nodiscard]] bool holds_any(const InsertChannels& gaussians) const;

  [[nodiscard]] std::uint32_t size() const { return count_; }
  [[nodiscard]] const CellKey* keys() const { return keys_.data(); }
  [[nodiscard]] const ModelledPoint* points() const { return points_.data(); }
  [[nodiscard]] float cell_size_m() const { return cell_size_m_; }

 private:
  device::StreamView stream_;
  float cell_size_m_;
  std::uint32_t count_ = 0;
  device::Buffer<CellKey> keys_, new_keys_, merged_keys_;
  device::Buffer<ModelledPoint> points_, new_points_, merged_points_;
};

}  // namespace splatbus::expander
