#include <algorithm>

#include "raster/cuda/adam_state.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256;

/// Rows [rows][kPageLanes] of each page.
struct Blocks {
  std::uint32_t* words;
  std::size_t rows;

  __device__ std::uint32_t& at(std::size_t row, std::uint32_t i) const {
    return words[((i >> kPageShift) * rows + row) * kPageLanes + (i & (kPageLanes - 1))];
  }
};

/// One thread an index and row; the rows behind the blocks' are the statistics, where they are gathered.
__global__ void move_kernel(Blocks blocks, ScreenStatistics statistics, const std::uint32_t* from,
                            const std::uint32_t* to, int count) {
  const int k = blockIdx.x * kThreads + threadIdx.x;
  if (k >= count) return;
  const std::uint32_t source = from[k], target = to[k];
  const std::size_t row = blockIdx.y;
  if (row < blocks.rows) {
    blocks.at(row, target) = blocks.at(row, source);
  } else if (row == blocks.rows) {
    statistics.mean2d_norm[target] = statistics.mean2d_norm[source];
  } else {
    statistics.steps[target] = statistics.steps[source];
  }
}

}  // namespace

void AdamState::grow(cudaStream_t stream) {
  const auto count = static_cast<std::size_t>(count_);
  // A growth maps more than one page, for each costs as much.
  constexpr std::size_t kPages = 16;
  const std::size_t pages = (((count + kPageLanes - 1) >> kPageShift) + kPages - 1) / kPages * kPages;
  moments_.grow(pages * rows() * kPageLanes * sizeof(float), stream);
  if (!gathers_) return;
  mean2d_norm_.grow(count * sizeof(float), stream);
  mean2d_steps_.grow(count * sizeof(std::uint32_t), stream);
}

void AdamState::reset(const ParameterLayout& layout, int count, cudaStream_t stream) {
  layout_ = layout;
  count_ = count;
  if (moments_.data() != nullptr) {
    check(cudaMemsetAsync(moments_.data(), 0, moments_.bytes(), stream), "clearing moments");
  }
  clear_statistics(stream);
  grow(stream);
}

void AdamState::resize(int count, cudaStream_t stream) {
  forget(count, count_ - count, stream);
  count_ = count;
  grow(stream);
}

void AdamState::forget(int first, int count, cudaStream_t stream) {
  for (int i = first; i < first + count;) {
    const auto lane = static_cast<std::size_t>(i) % kPageLanes;
    const std::size_t lanes = std::min<std::size_t>(kPageLanes - lane, static_cast<std::size_t>(first + count - i));
    std::byte* const block = moments_.data() + (static_cast<std::size_t>(i) >> kPageShift) * rows() * kPageLanes * 4;
    check(cudaMemset2DAsync(block + 4 * lane, 4 * kPageLanes, 0, 4 * lanes, rows(), stream), "clearing moments");
    i += static_cast<int>(lanes);
  }
  if (!gathers_ || count <= 0) return;
  const std::size_t begin = 4 * static_cast<std::size_t>(first), bytes = 4 * static_cast<std::size_t>(count);
  check(cudaMemsetAsync(mean2d_norm_.data() + begin, 0, bytes, stream), "clearing statistics");
  check(cudaMemsetAsync(mean2d_steps_.data() + begin, 0, bytes, stream), "clearing statistics");
}

void AdamState::move(const std::uint32_t* from, const std::uint32_t* to, int count, cudaStream_t stream) {
  if (count == 0) return;
  const dim3 blocks(static_cast<unsigned>((count + kThreads - 1) / kThreads),
                    static_cast<unsigned>(rows() + (gathers_ ? 2 : 0)));
  move_kernel<<<blocks, kThreads, 0, stream>>>({reinterpret_cast<std::uint32_t*>(moments_.data()), rows()},
                                               statistics(), from, to, count);
  check(cudaGetLastError(), "moving moments");
}

void AdamState::gather_statistics(bool gather, cudaStream_t stream) {
  if (gather == gathers_) return;
  gathers_ = gather;
  if (gather) return grow(stream);
  mean2d_norm_ = GrowingMemory(kMaxIndices * sizeof(float));
  mean2d_steps_ = GrowingMemory(kMaxIndices * sizeof(std::uint32_t));
}

void AdamState::clear_statistics(cudaStream_t stream) {
  if (mean2d_norm_.data() == nullptr) return;
  check(cudaMemsetAsync(mean2d_norm_.data(), 0, mean2d_norm_.bytes(), stream), "clearing statistics");
  check(cudaMemsetAsync(mean2d_steps_.data(), 0, mean2d_steps_.bytes(), stream), "clearing statistics");
}

}  // namespace splatbus::raster::cuda
