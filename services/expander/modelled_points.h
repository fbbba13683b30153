#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <unordered_map>
#include <vector>

#include "expander/cell_table.h"
#include "expander/insert_batch.h"
#include "expander/point_grid.h"
#include "model/published_model.h"

namespace splatbus::expander {

/// What is modelled: the points of the model's pages as they were read last, and those of batches that may not be in
/// them yet. Reading the model again costs what the pages do that have changed, and searching it what lies near the
/// cells that are searched; neither depends on how large the model is. Lives on one device. Not thread-safe. Throws as
/// insertion.h.
class ModelledPoints {
 public:
  /// `cells` is kept in step: how many points each has. It outlives this.
  ModelledPoints(device::StreamView stream, float cell_size_m, CellTable& cells);

  /// Takes over what has changed since the same trainer's model was read, all of another's, and forgets the batches.
  /// False, and nothing is changed, when the model's structure moved on meanwhile. It was opened on this device.
  [[nodiscard]] bool read(const PublishedModel& model, std::uint64_t trainer_epoch);
  void add(std::span<const InsertBatch* const> batches);
  void clear();

  /// Holds all that is modelled in those cells and in their neighbours of the same level, and more. Until the next call
  /// of anything but size(). `objects`: ascending by id.
  [[nodiscard]] const PointGrid& near(std::span<const CellCount> cells, std::span<const ObjectFrame> objects);
  /// Whether any point of the batch is modelled, to the last bit.
  [[nodiscard]] bool holds_any(const InsertBatch& batch);

  [[nodiscard]] std::size_t size() const { return size_; }                     ///< points that a cell holds
  [[nodiscard]] std::size_t pages_read() const { return pages_read_; }         ///< so far
  [[nodiscard]] std::size_t near_pages() const { return near_pages_.size(); }  ///< of the last search

 private:
  struct Page {
    std::uint64_t generation = 0;
    IndexRange range;  // count 0: there is none
    std::vector<CellCount> cells;
  };
  struct Added {
    InsertBatch batch;
    std::vector<CellCount> cells;
  };

  void take_page(std::uint32_t page, Page&& now, const ModelledPoint* points);
  void drop_page(std::uint32_t page);
  void index_page(std::uint32_t page);
  void unindex_page(std::uint32_t page);
  void drop_added();
  [[nodiscard]] ModelledPoint* lanes_of(std::uint32_t page);
  [[nodiscard]] std::vector<std::uint32_t> pages_near(std::span<const CellCount> cells) const;
  [[nodiscard]] float metres_per_unit(std::uint32_t frame_id) const;

  device::StreamView stream_;
  float cell_size_m_;
  CellTable& cells_;
  std::uint64_t trainer_epoch_ = 0;
  std::vector<Page> pages_;
  std::vector<device::Buffer<ModelledPoint>> arenas_;  // of the pages' points, in their frames' units
  std::vector<Added> added_;
  // Pages by the cells of kIndexLevel that their points lie in; those of an object, all together.
  std::map<CellKey, std::vector<std::uint32_t>> world_index_;
  std::unordered_map<std::uint32_t, std::vector<std::uint32_t>> object_index_;
  std::size_t size_ = 0, pages_read_ = 0;

  PointGrid near_;
  bool near_valid_ = false;  // near_ has all of near_pages_ and of added_
  std::vector<std::uint32_t> near_pages_;
  std::vector<ObjectFrame> objects_;  // of the last search: near_'s units
};

}  // namespace splatbus::expander
