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
// another thread, whatever has become of the replica. Rows stay where they are: a page's Gaussians are in blocks of
// kBlockRows rows, of which those in use are a block's first.

/// No Gaussians and no lights besides the sun, of another layout.
struct DisplayReset {
  StreamLayout layout;
};
/// All values of these rows; there are as many rows as the largest needs.
struct DisplayRows {
  std::vector<std::uint32_t> rows;
  QuantizedGaussians gaussians;  ///< a column a row
};
struct DisplayValues {
  Attribute attribute{};
  std::vector<std::uint32_t> rows;
  std::vector<std::int32_t> values;  ///< [channels][rows]
};
struct DisplayObjects {
  std::vector<std::uint32_t> rows, object_ids;
};
/// How many rows of a block are Gaussians from now on.
struct DisplayBlocks {
  struct Block {
    std::uint32_t block = 0, count = 0;
  };
  std::vector<Block> blocks;
};
/// Which lights there are besides the sun, by ascending id. New ones are seen by all; those that go are forgotten.
struct DisplayLights {
  std::vector<std::uint32_t> ids;
};
/// How much of a light is seen, of 255.
struct DisplaySeen {
  std::uint32_t light_id = 0;  ///< 0: the sun, beside its DisplayValues, while there are others
  std::vector<std::uint32_t> rows;
  Bytes values;
};

/// The newest visibility is of another version of the scene: what is seen of lights from here on belongs to it.
struct DisplayVisibility {
  std::uint64_t scene_version = 0;
};

using DisplayChange = std::variant<DisplayReset, DisplayRows, DisplayValues, DisplayObjects, DisplayBlocks,
                                   DisplayLights, DisplaySeen, DisplayVisibility>;

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

/// Of DisplayRows.
[[nodiscard]] std::size_t display_bytes(std::size_t channels, std::size_t rows);

}  // namespace splatbus::stream
