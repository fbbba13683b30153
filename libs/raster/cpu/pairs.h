#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>

namespace splatbus::raster::cpu {

/// A Gaussian that may reach blocks of a tile, before it has a place in the tile's list.
struct Pair {
  std::uint32_t tile, gaussian_and_blocks;
};

/// The same of a wide tile.
struct WidePair {
  std::uint32_t tile, gaussian, blocks;
};

/// Growing array whose room is asked for ahead, so that filling it needs no test.
template <class T>
class GrowingPairs {
 public:
  void clear() { size_ = 0; }
  /// Room for `more` pairs at the end; commit() takes what was written there.
  [[nodiscard]] T* room_for(std::size_t more) {
    if (size_ + more > capacity_) grow(size_ + more);
    return pairs_.get() + size_;
  }
  void commit(const T* end) { size_ = static_cast<std::size_t>(end - pairs_.get()); }
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] const T* begin() const { return pairs_.get(); }
  [[nodiscard]] const T* end() const { return pairs_.get() + size_; }

 private:
  void grow(std::size_t needed) {
    const std::size_t capacity = std::max<std::size_t>(needed + needed / 2, 1024);
    std::unique_ptr<T[]> larger(new T[capacity]);  // not initialised
    std::copy_n(pairs_.get(), size_, larger.get());
    pairs_ = std::move(larger);
    capacity_ = capacity;
  }
  std::unique_ptr<T[]> pairs_;
  std::size_t size_ = 0, capacity_ = 0;
};

using PairBuffer = GrowingPairs<Pair>;
using WidePairBuffer = GrowingPairs<WidePair>;

}  // namespace splatbus::raster::cpu
