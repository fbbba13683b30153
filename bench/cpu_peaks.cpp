#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <vector>

#include "bench/peaks.h"
#include "device/large_pages.h"

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "bench/cpu_peaks.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::bench::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using F = hn::ScalableTag<float>;
using V = hn::Vec<F>;

constexpr std::size_t kChains = 12;  // more than latency times ports, and held in registers

/// Returns how many multiply-adds that was; their result goes to `sink`.
std::size_t MultiplyAdd(std::size_t rounds, float* sink) {
  const F f;
  const V factor = hn::Set(f, 0.999F), term = hn::Set(f, 0.001F);
  V x[kChains];
  for (std::size_t j = 0; j < kChains; ++j) x[j] = hn::Set(f, 0.1F * static_cast<float>(j));
  for (std::size_t k = 0; k < rounds; ++k) {
    for (V& value : x) value = hn::MulAdd(value, factor, term);
  }
  V sum = x[0];
  for (std::size_t j = 1; j < kChains; ++j) sum = hn::Add(sum, x[j]);
  *sink = hn::GetLane(hn::SumOfLanes(f, sum));
  return rounds * kChains * hn::Lanes(f);
}

/// `count` is a multiple of any vector's lanes.
void ChangeInPlace(float* values, std::size_t count) {
  const F f;
  const V factor = hn::Set(f, 0.999F), term = hn::Set(f, 0.001F);
  for (std::size_t k = 0; k < count; k += hn::Lanes(f)) {
    hn::StoreU(hn::MulAdd(hn::LoadU(f, values + k), factor, term), f, values + k);
  }
}

void ReadAll(const float* values, std::size_t count, float* sink) {
  const F f;
  V sums[4] = {hn::Zero(f), hn::Zero(f), hn::Zero(f), hn::Zero(f)};
  const std::size_t lanes = hn::Lanes(f);
  for (std::size_t k = 0; k + 4 * lanes <= count; k += 4 * lanes) {
    for (std::size_t j = 0; j < 4; ++j) sums[j] = hn::Add(sums[j], hn::LoadU(f, values + k + j * lanes));
  }
  *sink = hn::GetLane(hn::SumOfLanes(f, hn::Add(hn::Add(sums[0], sums[1]), hn::Add(sums[2], sums[3]))));
}

}  // namespace splatbus::bench::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::bench {
namespace {

HWY_EXPORT(MultiplyAdd);
HWY_EXPORT(ChangeInPlace);
HWY_EXPORT(ReadAll);

constexpr int kTrials = 8;

/// Shortest of some trials, seconds.
template <class Body>
double best_seconds(const Body& body) {
  double best = 1e9;
  for (int trial = 0; trial < kTrials; ++trial) {
    const auto begin = std::chrono::steady_clock::now();
    body();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return best;
}

}  // namespace

Peaks measure_cpu_peaks(int threads, std::size_t bytes) {
  constexpr std::size_t kPiece = std::size_t{1} << 16U, kRounds = 20000;  // floats; about 100 microseconds
  const int cores = tbb::info::default_concurrency();
  const int used = threads > 0 ? std::min(threads, cores) : cores;
  tbb::task_arena arena(used);
  const std::size_t pieces = std::max<std::size_t>(bytes / sizeof(float) / kPiece, 1);
  std::vector<float, device::LargePageAllocator<float>> values(pieces * kPiece, 1.0F);
  const std::size_t tasks = std::size_t{64} * static_cast<std::size_t>(used);
  std::vector<float> sinks(std::max(pieces, tasks));
  std::vector<std::size_t> operations(tasks);
  const auto all = [&](std::size_t count, const auto& body) {
    arena.execute([&] { tbb::parallel_for(std::size_t{0}, count, body); });
  };

  Peaks peaks;
  const double changing = best_seconds([&] {
    all(pieces, [&](std::size_t k) { HWY_DYNAMIC_DISPATCH(ChangeInPlace)(values.data() + k * kPiece, kPiece); });
  });
  const double reading = best_seconds([&] {
    all(pieces, [&](std::size_t k) { HWY_DYNAMIC_DISPATCH(ReadAll)(values.data() + k * kPiece, kPiece, &sinks[k]); });
  });
  const auto size = static_cast<double>(values.size() * sizeof(float));
  peaks.bytes_per_s = std::max(2 * size / changing, size / reading);
  const double adding = best_seconds([&] {
    all(tasks, [&](std::size_t k) { operations[k] = HWY_DYNAMIC_DISPATCH(MultiplyAdd)(kRounds, &sinks[k]); });
  });
  peaks.operations_per_s = static_cast<double>(operations[0] * tasks) / adding;
  return peaks;
}

}  // namespace splatbus::bench
#endif
