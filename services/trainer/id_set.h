#pragma once

#include <algorithm>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include "model/channels.h"
#include "model/page_content.h"

namespace splatbus::trainer {

/// Ids that lie together in great numbers, in bounded memory: beyond it, none is known any more.
class IdSet {
 public:
  explicit IdSet(std::size_t max_bytes) : max_chunks_(max_bytes / sizeof(Chunk)) {}

  /// False where it was known.
  bool add(std::uint64_t id) {
    const std::uint64_t number = id / kChunkIds;
    auto found = chunks_.find(number);
    if (found == chunks_.end()) {
      if (chunks_.size() >= max_chunks_) return true;
      found = chunks_.emplace(number, std::make_unique<Chunk>()).first;
    }
    auto bit = (*found->second)[id % kChunkIds];
    if (bit) return false;
    bit = true;
    return true;
  }
  [[nodiscard]] bool contains(std::uint64_t id) const {
    const auto found = chunks_.find(id / kChunkIds);
    return found != chunks_.end() && (*found->second)[id % kChunkIds];
  }

  /// Adds a page's, and makes those that were known 0, which is nobody's.
  void drop_known(const ParameterLayout& layout, std::uint32_t count, std::vector<std::uint32_t>& words) {
    const model::PageStructure page{.count = count};
    for (std::uint32_t lane = 0; lane < count; ++lane) {
      if (add(model::id_of(layout, {page, words}, lane))) continue;
      const std::size_t row = model::rows_of(model::Channel::GaussianId, layout).first;
      std::fill_n(words.begin() + static_cast<std::ptrdiff_t>(row * count + std::size_t{2} * lane), 2, 0U);
    }
  }

 private:
  static constexpr std::size_t kChunkIds = 1 << 16;
  using Chunk = std::bitset<kChunkIds>;
  std::size_t max_chunks_;
  std::unordered_map<std::uint64_t, std::unique_ptr<Chunk>> chunks_;
};

}  // namespace splatbus::trainer
