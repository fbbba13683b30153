#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "bus/slab_range.h"
#include "bus/subscriber.h"
#include "gaussians/model.h"

namespace splatbus {

namespace model {
struct PageTableHeader;
}

/// A reader's hold on the trainer's live model, made from a model/published message. Where the pages lie in the memory
/// of the device that is asked for, they are read in place, and stay mapped while this lives: values change while they
/// are read (harmless). Elsewhere they are copied, and refresh() copies them again. The structure is whole only while
/// still_valid(): check it after reading and throw the result away when it is false (a newer model/published is then on
/// its way). Not thread-safe.
class PublishedModel {
 public:
  /// Parameters that the caller has no use for are not copied.
  enum class Need { Both, Average };

  /// Nullopt when a slab is gone or the structure has moved on since. Throws bus::Error when the message or the page
  /// table lies (sizes that contradict each other, pages that are nowhere; that values are finite is not checked). With
  /// the model that was read before, where its pages are mapped already is kept.
  [[nodiscard]] static std::optional<PublishedModel> open(const bus::Message& message, Device device = Device::Cpu,
                                                          Need need = Need::Both,
                                                          const PublishedModel* before = nullptr);

  PublishedModel(PublishedModel&&) noexcept = default;
  PublishedModel& operator=(PublishedModel&&) noexcept = default;
  PublishedModel(const PublishedModel&) = delete;
  PublishedModel& operator=(const PublishedModel&) = delete;
  ~PublishedModel() = default;

  /// Brings copied pages up to date; false when the structure has moved on. Pages that are read in place always are.
  [[nodiscard]] bool refresh();

  [[nodiscard]] std::uint64_t generation() const { return generation_; }
  [[nodiscard]] std::uint64_t step() const { return step_; }
  [[nodiscard]] std::size_t count() const { return count_; }  ///< Gaussians
  /// The parameters as the optimizer has them now; no parameters under Need::Average. In pages: ranges in host memory.
  [[nodiscard]] const GaussiansView& live() const { return live_; }
  /// Averaged over time: what is shown and streamed.
  [[nodiscard]] const GaussiansView& average() const { return average_; }
  /// Of each range's page: another one whenever its structure changes, freezing and thawing among it.
  [[nodiscard]] const std::vector<std::uint64_t>& page_generations() const { return page_generations_; }
  [[nodiscard]] bool still_valid() const;
  /// Bytes that open() and refresh() have copied out of, or into, device memory.
  [[nodiscard]] std::uint64_t copied_bytes() const { return copied_bytes_; }

 private:
  PublishedModel() = default;
  /// The table that the message names, in memory that is aligned for it.
  void take_table(const bus::Message& message, const bus::TensorView& tensor);
  /// Ranges, bounds and generations of the pages that hold Gaussians; false while one of them changes.
  [[nodiscard]] bool read_pages(const bus::Message& message, std::size_t arenas);
  void map_arenas(const PublishedModel* before);
  void make_views(std::byte* pages, Need need);

  std::uint64_t generation_ = 0, step_ = 0, copied_bytes_ = 0;
  std::size_t count_ = 0;
  GaussiansView live_, average_;
  std::vector<IndexRange> ranges_;
  std::vector<PageBounds> bounds_;
  std::vector<std::uint64_t> page_generations_;  ///< of each range's page
  std::vector<bus::TensorView> tensors_;         ///< the table, then the arenas
  std::shared_ptr<const std::byte> table_copy_;  ///< of a table that came with the message itself
  const model::PageTableHeader* table_ = nullptr;
  std::shared_ptr<bus::SlabRange> range_;  ///< null when pages are copied
  std::shared_ptr<std::byte> copies_;      ///< null when they are read in place
  Device device_ = Device::Cpu;
  Need need_ = Need::Both;
};

}  // namespace splatbus
