#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <glm/glm.hpp>
#include <memory>
#include <span>
#include <string>
#include <unordered_set>
#include <vector>

#include "bus/context.h"
#include "bus/publisher.h"
#include "trainer/insert_batch.h"
#include "trainer/model_slab.h"

namespace splatbus::trainer {

/// The live model in its slab "<source>/model": values change in place at any time; the structure changes only inside
/// change(), under the slot's sequence lock. A store that is made where a killed trainer's slab still lies goes on with
/// it.
///
/// Not thread-safe: it belongs to the optimizer's thread. Other processes read the slab through PublishedModel.
class ModelStore {
 public:
  struct Columns {
    std::size_t first = 0, count = 0;
  };

  /// Waits for the broker (bus::Error when it does not come). `max_gaussians` bounds growth.
  ModelStore(std::shared_ptr<bus::Context> bus, const ParameterLayout& layout, std::size_t capacity,
             std::size_t max_gaussians);

  /// How the store began, in words: "empty", "adopted ...", or why what was found was of no use.
  [[nodiscard]] const std::string& origin() const { return origin_; }

  [[nodiscard]] const ParameterLayout& layout() const { return planes_.layout; }
  [[nodiscard]] std::size_t count() const { return structure_.count; }
  [[nodiscard]] std::size_t capacity() const { return planes_.capacity; }
  [[nodiscard]] const Structure& structure() const { return structure_; }
  [[nodiscard]] const ModelPlanes& planes() const { return planes_; }
  [[nodiscard]] GaussiansView view() const { return planes_.view(structure_.count); }
  [[nodiscard]] bool holds(std::uint64_t epoch, std::uint64_t batch) const;

  [[nodiscard]] std::uint64_t step() const { return header_->step; }
  [[nodiscard]] std::uint64_t views() const { return header_->views; }
  [[nodiscard]] double optimizer_s() const { return header_->optimizer_s; }
  void add_step(std::size_t views, double seconds);

  /// Takes over the sun's visibility of the first columns, in place, when columns have not moved since `generation`.
  bool set_visibility(std::uint64_t generation, std::span<const float> visibility);

  /// Runs `work`, which may call the four functions below, as one change of structure with one new generation. When it
  /// throws, the structure stays as it was.
  void change(const std::function<void()>& work);

  /// Adds a batch's Gaussians and remembers the batch. None are added when the batch is held already, or belongs to an
  /// expander older than the newest one seen; what exceeds max_gaussians is left out.
  Columns append(const InsertBatch& batch);
  /// Adds a copy of each column, with a new id.
  Columns duplicate(const std::vector<std::uint32_t>& columns);
  /// Removes the columns with a non-zero entry. keep[i] of the result is the column that column i was.
  std::vector<std::uint32_t> remove(const std::vector<std::uint8_t>& dead);
  /// Sets or clears kFrozen of every Gaussian of the cells; one that freezes takes its average as its value. Returns
  /// how many changed.
  std::size_t set_frozen(const std::unordered_set<std::uint64_t>& cells, bool frozen);

  /// Publishes model/published with the slab as it is now.
  void publish(bus::Publisher& publisher) const;

 private:
  void create(std::size_t capacity);
  bool adopt(const std::string& role);
  void repair();
  void reserve(std::size_t count);
  void bind(std::shared_ptr<bus::Slab> slab, std::size_t capacity);
  void commit();
  void write_columns(const InsertBatch& batch, std::size_t first, std::size_t count) const;
  [[nodiscard]] std::string spare_role() const;

  std::shared_ptr<bus::Context> bus_;
  std::size_t max_gaussians_;
  std::string origin_;
  std::string role_ = "model";
  std::shared_ptr<bus::Slab> slab_;
  SlabHeader* header_ = nullptr;
  ModelPlanes planes_;
  Structure structure_;
  std::uint64_t slot_generation_ = 0;  ///< of the slab's sequence lock
};

/// What a Gaussian of the batch starts with in Radiance: constant band of the lit colour, display space (Kerbl et al.
/// 2023).
[[nodiscard]] glm::vec3 radiance_dc(const InsertBatch& batch, std::size_t row);

}  // namespace splatbus::trainer
