#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "trainer/insert_batch.h"
#include "trainer/model_columns.h"
#include "trainer/model_slab.h"

namespace splatbus::trainer {

/// The live model: its planes in a slab of either kind of memory, "<source>/model", and what says what they hold in one
/// of the host's, "<source>/model-header". Values change in place at any time; the structure changes only inside
/// change(), under the planes slot's sequence lock. A store that is made where a killed trainer's slabs still lie goes
/// on with them, whichever kind of memory that trainer had.
///
/// Not thread-safe: it belongs to the optimizer's thread. In device memory, whoever works on the planes on a stream of
/// his own waits for it before he calls change() or set_visibility(), and finds their work done when they return. Other
/// processes read the slab through PublishedModel.
class ModelStore {
 public:
  struct Columns {
    std::size_t first = 0, count = 0;
  };

  /// Waits for the broker (bus::Error when it does not come). `max_gaussians` bounds growth.
  ModelStore(std::shared_ptr<bus::Context> bus, const ParameterLayout& layout, std::size_t capacity,
             std::size_t max_gaussians, Device memory = Device::Cpu);

  /// How the store began, in words: "empty", "adopted ...", or why what was found was of no use.
  [[nodiscard]] const std::string& origin() const { return origin_; }

  /// Where the planes lie.
  [[nodiscard]] Device memory() const { return memory_; }
  [[nodiscard]] const ParameterLayout& layout() const { return planes_.layout; }
  [[nodiscard]] std::size_t count() const { return structure_.count; }
  [[nodiscard]] std::size_t capacity() const { return planes_.capacity; }
  [[nodiscard]] const Structure& structure() const { return structure_; }
  [[nodiscard]] const ModelPlanes& planes() const { return planes_; }
  [[nodiscard]] GaussiansView view() const { return planes_.view(structure_.count); }
  /// Gaussians that `count` may grow by.
  [[nodiscard]] std::size_t room(std::size_t count) const { return max_gaussians_ - std::min(max_gaussians_, count); }
  /// What capacity() becomes when there are that many.
  [[nodiscard]] std::size_t capacity_for(std::size_t count) const;
  [[nodiscard]] bool holds(std::uint64_t epoch, std::uint64_t batch) const;

  [[nodiscard]] std::uint64_t step() const { return header_->step; }
  [[nodiscard]] std::uint64_t views() const { return header_->views; }
  [[nodiscard]] double optimizer_s() const { return header_->optimizer_s; }
  void add_step(std::size_t views, double seconds);
  /// Time of steps that were added without it.
  void add_time(double seconds) { header_->optimizer_s += seconds; }

  /// Whether no column has moved since that generation, and there are as many.
  [[nodiscard]] bool accepts_visibility(std::uint64_t generation, std::size_t count) const;
  /// Takes over the sun's visibility of the first `count` columns, in place, from values in either memory, when columns
  /// have not moved since `generation`.
  bool set_visibility(std::uint64_t generation, const float* values, Device memory, std::size_t count);

  /// Runs `work`, which may call the four functions below, as one change of structure with one new generation. When it
  /// throws, the planes stay locked: only another store can go on, with the structure as it was.
  void change(const std::function<void()>& work);

  /// Adds a batch's Gaussians and remembers the batch. None are added when the batch is held already, or belongs to an
  /// expander older than the newest one seen; what exceeds max_gaussians is left out.
  Columns append(const InsertBatch& batch);
  /// Adds a copy of each column, with a new id.
  Columns duplicate(const std::vector<std::uint32_t>& columns);
  /// Removes the columns with a non-zero entry; `dead` is [count()], in memory().
  ColumnMoves remove(const std::uint8_t* dead);

  /// Publishes model/published with the slab as it is now.
  void publish(const bus::Publisher& publisher) const;

 private:
  void begin_empty(std::size_t capacity);
  bool adopt();
  [[nodiscard]] std::shared_ptr<bus::Slab> adopt_planes(const Structure& structure) const;
  void repair();
  void reserve(std::size_t count);
  void move_planes(std::size_t capacity);
  [[nodiscard]] std::shared_ptr<bus::Slab> create_planes(const std::string& role, std::size_t capacity) const;
  [[nodiscard]] std::string spare_role() const;
  void bind(std::shared_ptr<bus::Slab> slab, std::size_t capacity);
  void commit();

  std::shared_ptr<bus::Context> bus_;
  std::size_t max_gaussians_;
  Device memory_;
  std::unique_ptr<ModelColumns> columns_;
  std::string origin_;
  std::shared_ptr<bus::Slab> header_slab_, planes_slab_;
  SlabHeader* header_ = nullptr;
  ModelPlanes planes_;
  Structure structure_;
  std::uint64_t slot_generation_ = 0;  ///< of the planes slot's sequence lock
};

}  // namespace splatbus::trainer
