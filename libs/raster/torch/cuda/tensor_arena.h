#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <vector>

#include "raster/torch/tensor.h"

namespace splatbus::raster::cuda {

/// Arrays that are asked for one by one and lie in one tensor, so that LibTorch's allocator is asked once.
class TensorArena {
 public:
  /// `pointer` is set by allocate(); null for an empty array.
  template <class T>
  void add(T*& pointer, std::size_t elements) {
    pointer = nullptr;
    if (elements == 0) return;
    setters_.push_back([&pointer, at = bytes_](std::byte* base) { pointer = reinterpret_cast<T*>(base + at); });
    constexpr std::size_t kAlignment = 256;
    bytes_ += (elements * sizeof(T) + kAlignment - 1) / kAlignment * kAlignment;
  }

  /// Uninitialised memory for everything that was added, on the device of `type`.
  [[nodiscard]] torch::Tensor allocate(const torch::TensorOptions& type) {
    torch::Tensor memory =
        torch::empty({static_cast<std::int64_t>(std::max<std::size_t>(bytes_, 1))}, type.dtype(at::kByte));
    auto* const base = static_cast<std::byte*>(memory.data_ptr());
    for (const auto& set : setters_) set(base);
    return memory;
  }

 private:
  std::size_t bytes_ = 0;
  std::vector<std::function<void(std::byte*)>> setters_;
};

}  // namespace splatbus::raster::cuda
