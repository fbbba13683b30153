#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "gaussians/model.h"
#include "stream/display_changes.h"
#include "stream/pending_rows.h"

namespace splatbus::stream {

/// The floats that a rasterizer reads, in the memory of a stream's device: only what changes goes there, the changes of
/// many pages at a time, for a device that others use as well lets each call wait. Rows grow by doubling, so
/// that a model which arrives page by page is not copied once a page. One thread, any. Each call has been done when it
/// returns. Throws std::runtime_error when the device fails.
class DisplayGaussians {
 public:
  explicit DisplayGaussians(device::StreamView stream = {}) : DisplayGaussians(StreamLayout{}, stream) {}

  /// Asserts that they follow on what was applied before, from a DisplayReset on.
  void apply(const DisplayChanges& changes);

  [[nodiscard]] std::size_t count() const { return count_; }
  /// In ranges, one a page of one array, without bounds; rows of a range that are no Gaussian's are transparent: a
  /// rasteriser takes room for whole pages, and a page here has several of the stream's. Valid until the next change.
  /// gaussian_id, surface_point and flags are null; without Transfer normal and visibility too.
  [[nodiscard]] GaussiansView view() const;
  /// The same under a light with these sources, by ascending id: rows of visibility_u8 in their order, one that is not
  /// known seen by all.
  [[nodiscard]] GaussiansView view(const std::vector<LightSource>& sources);

 private:
  DisplayGaussians(const StreamLayout& layout, device::StreamView stream);

  void apply(const DisplayReset& change);
  void apply(const DisplayRows& change);
  void apply(const DisplayValues& change);
  void apply(const DisplayObjects& change);
  void apply(const DisplayBlocks& change);
  void apply(const DisplayLights& change);
  void apply(const DisplaySeen& change);
  void apply(const DisplayVisibility&) {}
  void reserve(std::size_t rows);
  /// Adds to what is pending, or, where that is much, writes it at once. `write(rows, values)` does.
  template <class T, class Write>
  void gather(PendingRows<T>& pending, const std::vector<std::uint32_t>& rows, const std::vector<T>& values,
              Write&& write);
  /// Writes what is pending.
  void flush();
  // To be waited for before their arguments go.
  void write_values(const AttributeChannels& attribute, const std::vector<std::uint32_t>& rows,
                    const std::vector<std::int32_t>& values);
  void write_objects(const std::vector<std::uint32_t>& rows, const std::vector<std::uint32_t>& ids);
  void write_seen(std::uint32_t light_id, const std::vector<std::uint32_t>& rows, const Bytes& seen);
  void list_ranges();
  [[nodiscard]] int row_of(Attribute attribute) const;
  /// Rows for `ids` in `to`, [1 + ids][stride], from what is seen now.
  void gather_lights(const std::vector<std::uint32_t>& ids, std::size_t stride, device::Buffer<std::uint8_t>& to);
  [[nodiscard]] std::uint8_t* seen_row(std::uint32_t light_id) const;
  [[nodiscard]] float* row(int index) const { return rows_.data() + static_cast<std::size_t>(index) * stride_; }

  StreamLayout layout_;
  device::StreamView stream_;
  int row_count_;
  std::size_t count_ = 0, stride_ = 0;
  std::vector<std::uint32_t> block_counts_;
  std::vector<IndexRange> ranges_;           ///< of the blocks with Gaussians
  device::Buffer<float> rows_;               ///< [row_count_][stride_]: parameters, normal, visibility
  device::Buffer<std::uint32_t> object_id_;  ///< [stride_]
  std::vector<std::uint32_t> lights_;
  device::Buffer<std::uint8_t> seen_;    ///< [1 + lights][stride_], the sun's first; empty without lights
  device::Buffer<std::uint8_t> others_;  ///< the same in the order of other lights
  std::vector<PendingRows<std::int32_t>> pending_values_;  ///< of each attribute of the layout
  PendingRows<std::uint32_t> pending_objects_;
  std::map<std::uint32_t, PendingRows<std::uint8_t>> pending_seen_;  ///< by light
  PendingRows<std::uint32_t> pending_hidden_;                        ///< opacity of rows of nobody, after all that
  std::size_t pending_bytes_ = 0;
  device::Buffer<std::uint32_t> ids_, columns_;
  device::Buffer<std::uint8_t> bytes_;
  device::Buffer<std::int32_t> values_;
};

}  // namespace splatbus::stream
