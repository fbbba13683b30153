#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "stream/bytes.h"

namespace splatbus::stream {

/// How much Gaussians see of each light besides the sun: a byte a row, 255 sees all of it, and so does a row that
/// nothing has been said of.
class LightRows {
 public:
  /// Those of lights that are not among `ids`, which ascend, are dropped. True when they were others.
  bool set_lights(std::span<const std::uint32_t> ids, std::size_t slots);
  void resize(std::size_t slots);
  void move(std::size_t from, std::size_t to);
  /// Nothing has been said of it.
  void forget(std::size_t slot);

  /// Null for a light that is not there.
  [[nodiscard]] Bytes* find(std::uint32_t id);
  [[nodiscard]] const Bytes* find(std::uint32_t id) const { return const_cast<LightRows*>(this)->find(id); }
  /// By ascending light id.
  [[nodiscard]] const std::map<std::uint32_t, Bytes>& all() const { return rows_; }
  [[nodiscard]] std::vector<std::uint32_t> ids() const;

  bool operator==(const LightRows&) const = default;

 private:
  std::map<std::uint32_t, Bytes> rows_;
};

}  // namespace splatbus::stream
