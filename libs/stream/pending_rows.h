#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace splatbus::stream {

/// Values for rows, gathered from many small changes so that a device is given few large ones. Each row at most once:
/// what is written at the same time has no order.
template <class T>
class PendingRows {
 public:
  explicit PendingRows(std::size_t channels = 1) : channels_(channels) {}

  [[nodiscard]] bool empty() const { return rows_.empty(); }
  [[nodiscard]] bool any_of(std::span<const std::uint32_t> rows) const {
    return std::ranges::any_of(rows, [this](std::uint32_t row) { return row < taken_.size() && taken_[row]; });
  }

  /// `values`: [channels][rows]. Of these rows none is pending.
  void add(std::span<const std::uint32_t> rows, std::span<const T> values) {
    assert(values.size() == channels_.size() * rows.size());
    for (std::size_t c = 0; c < channels_.size(); ++c) {
      const auto plane = values.subspan(c * rows.size(), rows.size());
      channels_[c].insert(channels_[c].end(), plane.begin(), plane.end());
    }
    rows_.insert(rows_.end(), rows.begin(), rows.end());
    for (const std::uint32_t row : rows) {
      if (row >= taken_.size()) taken_.resize(std::size_t{row} + 1);
      taken_[row] = true;
    }
  }

  [[nodiscard]] const std::vector<std::uint32_t>& rows() const { return rows_; }
  /// [channels][rows].
  [[nodiscard]] std::vector<T> values() const {
    std::vector<T> values;
    values.reserve(channels_.size() * rows_.size());
    for (const std::vector<T>& plane : channels_) values.insert(values.end(), plane.begin(), plane.end());
    return values;
  }

  void clear() {
    for (const std::uint32_t row : rows_) taken_[row] = false;
    for (std::vector<T>& plane : channels_) plane.clear();
    rows_.clear();
  }

 private:
  std::vector<std::vector<T>> channels_;
  std::vector<std::uint32_t> rows_;
  std::vector<bool> taken_;  ///< by row
};

}  // namespace splatbus::stream
