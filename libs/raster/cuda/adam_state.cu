#include <algorithm>
#include <cub/block/block_reduce.cuh>
#include <utility>

#include "raster/cuda/adam_state.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kCounters = OptimizerState::kCounters;

/// A page's block, and what is kept of it while it rests: mean second moments [channels], then its counters
/// [kCounters][kPageLanes].
struct Places {
  float* block;
  float* rest;
};

/// One thread an index and row; the rows behind the blocks' are the statistics, where they are gathered.
__global__ void move_kernel(float* const* blocks, unsigned rows, ScreenStatistics statistics, const std::uint32_t* from,
                            const std::uint32_t* to, std::size_t count) {
  const std::size_t k = std::size_t{blockIdx.x} * kThreads + threadIdx.x;
  if (k >= count) return;
  const std::uint32_t source = from[k], target = to[k], row = blockIdx.y;
  if (row < rows) {
    const float* const of_source = blocks[source >> kPageShift];
    float* const of_target = blocks[target >> kPageShift];
    if (of_target == nullptr) return;
    of_target[row * kPageLanes + (target & (kPageLanes - 1))] =
        of_source != nullptr ? of_source[row * kPageLanes + (source & (kPageLanes - 1))] : 0.0F;
  } else if (row == rows) {
    statistics.mean2d_norm[target] = statistics.mean2d_norm[source];
  } else {
    statistics.steps[target] = statistics.steps[source];
  }
}

/// What a second moment is, so far, of what it tends to.
__device__ float second_bias(const float* counters, int lane, float beta2) {
  return 1.0F - powf(beta2, static_cast<float>(reinterpret_cast<const std::uint32_t*>(counters)[lane]));
}

/// One block a page and channel, or counter behind them.
__global__ void __launch_bounds__(kThreads) rest_kernel(const Places* places, int channels, float beta2) {
  const Places of = places[blockIdx.x];
  const int row = static_cast<int>(blockIdx.y);
  const float* const counters = of.block + 2 * channels * static_cast<int>(kPageLanes);
  if (row >= channels) {
    const int counter = (row - channels) * static_cast<int>(kPageLanes);
    for (int lane = threadIdx.x; lane < static_cast<int>(kPageLanes); lane += kThreads) {
      of.rest[channels + counter + lane] = counters[counter + lane];
    }
    return;
  }
  const float* const second = of.block + (channels + row) * static_cast<int>(kPageLanes);
  float sum = 0.0F, trained = 0.0F;
  for (int lane = threadIdx.x; lane < static_cast<int>(kPageLanes); lane += kThreads) {
    const float bias = second_bias(counters, lane, beta2);
    if (!(bias > 0.0F)) continue;
    sum += second[lane] / bias;
    trained += 1.0F;
  }
  using Reduce = cub::BlockReduce<float, kThreads>;
  __shared__ typename Reduce::TempStorage scratch[2];
  sum = Reduce(scratch[0]).Sum(sum);
  trained = Reduce(scratch[1]).Sum(trained);
  if (threadIdx.x == 0) of.rest[row] = trained > 0.0F ? sum / trained : 0.0F;
}

/// The way back, of a block that is zero.
__global__ void __launch_bounds__(kThreads) wake_kernel(const Places* places, int channels, float beta2) {
  const Places of = places[blockIdx.x];
  const int row = static_cast<int>(blockIdx.y);
  const float* const counters = of.rest + channels;
  for (int lane = threadIdx.x; lane < static_cast<int>(kPageLanes); lane += kThreads) {
    if (row >= channels) {
      const int counter = (row - channels) * static_cast<int>(kPageLanes);
      of.block[2 * channels * static_cast<int>(kPageLanes) + counter + lane] = counters[counter + lane];
    } else {
      of.block[(channels + row) * static_cast<int>(kPageLanes) + lane] =
          second_bias(counters, lane, beta2) * of.rest[row];
    }
  }
}

/// Runs one of the two for each page.
template <class Kernel>
void launch(Kernel kernel, const std::vector<Places>& pages, device::Buffer<std::byte>& scratch, int channels,
            float beta2, cudaStream_t stream) {
  if (pages.empty()) return;
  scratch.upload(reinterpret_cast<const std::byte*>(pages.data()), pages.size() * sizeof(Places), stream);
  const dim3 blocks(static_cast<unsigned>(pages.size()), static_cast<unsigned>(channels + kCounters));
  kernel<<<blocks, kThreads, 0, stream>>>(reinterpret_cast<const Places*>(scratch.data()), channels, beta2);
  check(cudaGetLastError(), "pages' moments");
}

std::size_t pages_of(std::size_t count) {
  return (count + kPageLanes - 1) >> kPageShift;
}

}  // namespace

void AdamState::reset(const ParameterLayout& layout, int count, std::span<const IndexRange> ranges,
                      cudaStream_t stream) {
  layout_ = layout;
  pages_.clear();
  blocks_.reset(rows() * kPageLanes);
  rests_.reset(channels() + kCounters * kPageLanes);
  host_table_.clear();
  clear_statistics(stream);
  count_ = 0;
  follow(count, {.ranges = ranges, .fresh = {}}, 0, stream);
}

void AdamState::follow(int count, const ModelChange& change, float beta2, cudaStream_t stream) {
  const auto now = static_cast<std::size_t>(count), before = static_cast<std::size_t>(count_);
  pages_.resize(pages_of(std::max(now, before)));
  grow(std::max(now, before), stream);
  const std::vector<PageState> states = states_of(now, change.ranges);
  take_blocks(states, change.fresh, beta2, stream);
  for (const IndexRange& range : change.fresh) forget(range.first, range.count, stream);
  move(change, stream);
  if (now < before) forget(now, before - now, stream);  // those that come back begin anew
  count_ = count;
  give_blocks(states, beta2, stream);
}

std::vector<AdamState::PageState> AdamState::states_of(std::size_t count, std::span<const IndexRange> ranges) const {
  std::vector<PageState> states(pages_.size(), PageState::Absent);
  if (ranges.empty()) std::fill_n(states.begin(), pages_of(count), PageState::Trains);
  for (const IndexRange& range : ranges) {
    states[range.first >> kPageShift] = range.frozen != 0 ? PageState::Frozen : PageState::Trains;
  }
  return states;
}

/// To pages that train, and for the change to resting ones that are no more or that it begins anew.
void AdamState::take_blocks(const std::vector<PageState>& states, std::span<const IndexRange> fresh, float beta2,
                            cudaStream_t stream) {
  std::vector<Places> woken;
  const auto take = [&](Page& page) {
    if (page.block) return;
    page.block = blocks_.take();
    check(cudaMemsetAsync(blocks_.data(*page.block), 0, blocks_.floats() * sizeof(float), stream), "clearing moments");
    if (page.rest) woken.push_back({blocks_.data(*page.block), rests_.data(*page.rest)});
  };
  for (std::size_t k = 0; k < pages_.size(); ++k) {
    if (states[k] == PageState::Trains || (states[k] == PageState::Absent && pages_[k].rest)) take(pages_[k]);
  }
  for (const IndexRange& range : fresh) {
    Page& page = pages_[range.first >> kPageShift];
    if (page.rest) take(page);
  }
  launch(wake_kernel, woken, places_, static_cast<int>(channels()), beta2, stream);
  for (Page& page : pages_) {
    if (page.block && page.rest) rests_.give(*std::exchange(page.rest, std::nullopt));
  }
  upload_table(stream);
}

/// Of pages that do not train.
void AdamState::give_blocks(const std::vector<PageState>& states, float beta2, cudaStream_t stream) {
  std::vector<Places> resting;
  for (std::size_t k = 0; k < pages_.size(); ++k) {
    Page& page = pages_[k];
    if (states[k] == PageState::Trains || !page.block) continue;
    if (states[k] == PageState::Frozen) {
      page.rest = rests_.take();
      resting.push_back({blocks_.data(*page.block), rests_.data(*page.rest)});
    }
    blocks_.give(*std::exchange(page.block, std::nullopt));
  }
  launch(rest_kernel, resting, places_, static_cast<int>(channels()), beta2, stream);
  pages_.resize(pages_of(static_cast<std::size_t>(count_)));
  blocks_.shrink(stream, [&](auto from, auto to) {
    for (Page& page : pages_) {
      if (page.block == from) page.block = to;
    }
  });
  rests_.shrink(stream, [&](auto from, auto to) {
    for (Page& page : pages_) {
      if (page.rest == from) page.rest = to;
    }
  });
  upload_table(stream);
}

PageMoments AdamState::moments_of(std::size_t page) const {
  if (page >= pages_.size()) return PageMoments::None;
  if (pages_[page].block) return PageMoments::Trains;
  return pages_[page].rest ? PageMoments::Rests : PageMoments::None;
}

void AdamState::save(std::size_t page, float* moments, cudaStream_t stream) const {
  const PageMoments kind = moments_of(page);
  if (kind == PageMoments::None) return;
  const float* const from =
      kind == PageMoments::Trains ? blocks_.data(*pages_[page].block) : rests_.data(*pages_[page].rest);
  check(cudaMemcpyAsync(moments, from, moment_floats(kind, channels()) * sizeof(float), cudaMemcpyDefault, stream),
        "saving moments");
}

void AdamState::restore(std::size_t page, PageMoments kind, const float* moments, cudaStream_t stream) {
  if (kind == PageMoments::None || page >= pages_.size()) return;
  Page& of = pages_[page];
  if (kind == PageMoments::Rests && !of.block && !of.rest) of.rest = rests_.take();
  if (kind != moments_of(page)) return;
  float* const to = kind == PageMoments::Trains ? blocks_.data(*of.block) : rests_.data(*of.rest);
  check(cudaMemcpyAsync(to, moments, moment_floats(kind, channels()) * sizeof(float), cudaMemcpyDefault, stream),
        "restoring moments");
}

void AdamState::upload_table(cudaStream_t stream) {
  std::vector<float*> table;
  table.reserve(pages_.size());
  for (const Page& page : pages_) table.push_back(page.block ? blocks_.data(*page.block) : nullptr);
  if (table == host_table_) return;
  host_table_ = std::move(table);
  table_.upload(host_table_.data(), host_table_.size(), stream);
}

void AdamState::forget(std::size_t first, std::size_t count, cudaStream_t stream) {
  for (std::size_t i = first; i < first + count;) {
    const std::size_t lane = i % kPageLanes, lanes = std::min<std::size_t>(kPageLanes - lane, first + count - i);
    const Page& page = pages_[i >> kPageShift];
    if (page.block) {
      float* const begin = blocks_.data(*page.block) + lane;
      check(cudaMemset2DAsync(begin, sizeof(float) * kPageLanes, 0, sizeof(float) * lanes, rows(), stream),
            "clearing moments");
    }
    i += lanes;
  }
  if (!gathers_ || count == 0) return;
  check(cudaMemsetAsync(mean2d_norm_.data() + 4 * first, 0, 4 * count, stream), "clearing statistics");
  check(cudaMemsetAsync(mean2d_steps_.data() + 4 * first, 0, 4 * count, stream), "clearing statistics");
}

void AdamState::move(const ModelChange& change, cudaStream_t stream) {
  if (change.moves == 0) return;
  const dim3 blocks(static_cast<unsigned>((change.moves + kThreads - 1) / kThreads),
                    static_cast<unsigned>(rows() + (gathers_ ? 2 : 0)));
  move_kernel<<<blocks, kThreads, 0, stream>>>(table_.data(), static_cast<unsigned>(rows()), statistics(), change.from,
                                               change.to, change.moves);
  check(cudaGetLastError(), "moving moments");
}

void AdamState::grow(std::size_t count, cudaStream_t stream) {
  if (!gathers_) return;
  mean2d_norm_.grow(count * sizeof(float), stream);
  mean2d_steps_.grow(count * sizeof(std::uint32_t), stream);
}

void AdamState::gather_statistics(bool gather, cudaStream_t stream) {
  if (gather == gathers_) return;
  gathers_ = gather;
  if (gather) return grow(static_cast<std::size_t>(count_), stream);
  mean2d_norm_ = GrowingMemory(kMaxIndices * sizeof(float));
  mean2d_steps_ = GrowingMemory(kMaxIndices * sizeof(std::uint32_t));
}

void AdamState::clear_statistics(cudaStream_t stream) {
  if (mean2d_norm_.data() == nullptr) return;
  check(cudaMemsetAsync(mean2d_norm_.data(), 0, mean2d_norm_.bytes(), stream), "clearing statistics");
  check(cudaMemsetAsync(mean2d_steps_.data(), 0, mean2d_steps_.bytes(), stream), "clearing statistics");
}

}  // namespace splatbus::raster::cuda
