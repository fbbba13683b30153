#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <variant>
#include <vector>

#include "stream/bytes.h"
#include "stream/layout.h"
#include "stream/quantized.h"

namespace splatbus::stream {

// What a DisplayGaussians has to do to follow a Replica. Each holds its own values, so that it may be applied on
// another thread, whatever has become of the replica.

/// No Gaussians and no lights besides the sun, of another layout.
struct DisplayReset {
  StreamLayout layout;
};
struct DisplayAppend {
  QuantizedGaussians gaussians;
};
struct DisplayValues {
  Attribute attribute{};
  std::vector<std::uint32_t> columns;
  std::vector<std::int32_t> values;  ///< [channels][columns]
};
struct DisplayObjects {
  std::vector<std::uint32_t> columns, object_ids;
};
struct DisplayRemoval {
  std::vector<std::uint32_t> ascending;
};
/// Which lights there are besides the sun, by ascending id. New ones are seen by all; those that go are forgotten.
struct DisplayLights {
  std::vector<std::uint32_t> ids;
};
/// How much of a light is seen, of 255.
struct DisplaySeen {
  std::uint32_t light_id = 0;  ///< 0: the sun, beside its DisplayValues, while there are others
  std::vector<std::uint32_t> columns;
  Bytes values;
};
/// Column i becomes what column order[i] was; a permutation of all columns.
struct DisplayOrder {
  std::vector<std::uint32_t> order;
};

using DisplayChange = std::variant<DisplayReset, DisplayAppend, DisplayValues, DisplayObjects, DisplayLights,
                                   DisplaySeen, DisplayRemoval, DisplayOrder>;

/// In the order in which they are to be applied.
class DisplayChanges {
 public:
  void add(DisplayChange change) {
    bytes_ += bytes_of(change);
    list_.push_back(std::move(change));
  }
  void append(DisplayChanges&& later) {
    bytes_ += std::exchange(later.bytes_, 0);
    for (DisplayChange& change : later.list_) list_.push_back(std::move(change));
    later.list_.clear();
  }
  void clear() { *this = {}; }

  [[nodiscard]] const std::vector<DisplayChange>& list() const { return list_; }
  [[nodiscard]] bool empty() const { return list_.empty(); }
  /// About.
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  [[nodiscard]] static std::size_t bytes_of(const DisplayChange& change);

  std::vector<DisplayChange> list_;
  std::size_t bytes_ = 0;
};

/// Of a DisplayAppend.
[[nodiscard]] std::size_t display_bytes(const QuantizedGaussians& gaussians);

}  // namespace splatbus::stream
