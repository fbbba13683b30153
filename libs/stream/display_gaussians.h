#pragma once

#include <cstdint>
#include <vector>

#include "device/buffer.h"
#include "gaussians/model.h"
#include "stream/display_changes.h"

namespace splatbus::stream {

/// The floats that a rasterizer reads, in the memory of a stream's device: only what changes goes there. Columns grow
/// by doubling, so that a model which arrives chunk by chunk is not copied once a chunk. One thread, any. Each call has
/// been done when it returns. Throws std::runtime_error when the device fails.
class DisplayGaussians {
 public:
  explicit DisplayGaussians(device::StreamView stream = {}) : DisplayGaussians(StreamLayout{}, stream) {}

  /// Asserts that they follow on what was applied before, from a DisplayReset on.
  void apply(const DisplayChanges& changes);

  [[nodiscard]] std::size_t count() const { return count_; }
  /// Valid until the next change. gaussian_id, surface_point, flags and cell are null; without Transfer normal and
  /// visibility too.
  [[nodiscard]] GaussiansView view() const;

 private:
  DisplayGaussians(const StreamLayout& layout, device::StreamView stream);

  void apply(const DisplayReset& change);
  void apply(const DisplayAppend& change);
  void apply(const DisplayValues& change);
  void apply(const DisplayObjects& change);
  void apply(const DisplayRemoval& change);
  void apply(const DisplayOrder& change) { gather(change.order, 0); }
  void reserve(std::size_t columns);
  /// Columns from `first` on become order's, of which there may be fewer.
  void gather(const std::vector<std::uint32_t>& order, std::size_t first);
  [[nodiscard]] int row_of(Attribute attribute) const;
  [[nodiscard]] float* row(int index) const { return rows_.data() + static_cast<std::size_t>(index) * stride_; }

  StreamLayout layout_;
  device::StreamView stream_;
  int row_count_;
  std::size_t count_ = 0, stride_ = 0;
  device::Buffer<float> rows_;               ///< [row_count_][stride_]: parameters, normal, visibility
  device::Buffer<std::uint32_t> object_id_;  ///< [stride_]
  device::Buffer<float> moved_;
  device::Buffer<std::uint32_t> moved_ids_, columns_;
  device::Buffer<std::int32_t> values_;
};

}  // namespace splatbus::stream
