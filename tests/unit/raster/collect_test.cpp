#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <bit>
#include <cmath>
#include <map>
#include <new>
#include <numeric>
#include <utility>
#include <vector>

#include "raster/cpu/kernels.h"
#include "scenes.h"

namespace splatbus::raster {
namespace {

using testing::TestScene;

/// Zeroed counters that end where memory ends: touching one past the last is a fault, even to add nothing to it.
class GuardedCounters {
 public:
  explicit GuardedCounters(std::size_t count) : page_(static_cast<std::size_t>(::sysconf(_SC_PAGESIZE))) {
    pages_ = (count * sizeof(std::uint32_t) + page_ - 1) / page_;
    memory_ = ::mmap(nullptr, (pages_ + 1) * page_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (memory_ == MAP_FAILED) throw std::bad_alloc();
    auto* guard = static_cast<std::byte*>(memory_) + pages_ * page_;
    if (::mprotect(guard, page_, PROT_NONE) != 0) throw std::bad_alloc();
    counters_ = reinterpret_cast<std::uint32_t*>(guard) - count;
  }
  ~GuardedCounters() { ::munmap(memory_, (pages_ + 1) * page_); }
  GuardedCounters(const GuardedCounters&) = delete;
  GuardedCounters& operator=(const GuardedCounters&) = delete;

  [[nodiscard]] std::uint32_t* data() { return counters_; }

 private:
  std::size_t page_, pages_ = 0;
  void* memory_ = nullptr;
  std::uint32_t* counters_ = nullptr;
};

/// The Gaussians of a scene as the projection leaves them for collect_pairs() or, where nothing is kept, for
/// collect_wide_pairs().
cpu::Frame projected(const TestScene& scene, const Camera& camera, bool keep = true) {
  cpu::Frame frame;
  frame.keep = keep;
  frame.gaussians = scene.view();
  frame.camera = camera;
  frame.objects.build(camera, scene.state);
  frame.tan_limit_x_low = frame.tan_limit_y_low = -10;
  frame.tan_limit_x_high = frame.tan_limit_y_high = 10;
  const std::uint32_t side = cpu::tile_side(keep);
  frame.tiles_x = (camera.width + side - 1) / side;
  frame.tiles_y = (camera.height + side - 1) / side;
  frame.splats.reserve(scene.count);
  frame.reaches.reserve(scene.count);
  frame.pair_ranges.reserve(scene.count);
  frame.order.reserve(scene.count);
  frame.visible = cpu::project_range(frame, {0, static_cast<std::uint32_t>(scene.count)}, frame.order.data());
  return frame;
}

/// The blocks of every tile, as a mask, in which the Gaussian's alpha reaches 1/255 at a pixel's centre, by trying all.
std::map<std::uint32_t, std::uint32_t> blocks_by_search(const cpu::Frame& frame, const cpu::Splat& splat) {
  std::map<std::uint32_t, std::uint32_t> blocks;
  const std::uint32_t side = cpu::tile_side(frame.keep), row = side / cpu::kBlockSide;
  for (std::uint32_t y = 0; y < frame.camera.height; ++y) {
    for (std::uint32_t x = 0; x < frame.camera.width; ++x) {
      const float dx = static_cast<float>(x) + 0.5F - splat.x, dy = static_cast<float>(y) + 0.5F - splat.y;
      const float u = splat.uxx * dx + splat.uxy * dy, v = splat.uyy * dy;
      if (std::exp2(splat.log2_alpha - u * u - v * v) < cpu::kAlphaMin) continue;
      const std::uint32_t block = y % side / cpu::kBlockSide * row + x % side / cpu::kBlockSide;
      blocks[y / side * frame.tiles_x + x / side] |= 1U << block;
    }
  }
  return blocks;
}

/// Of which there is no memory for many.
struct Scarce {
  std::uint32_t value;

  static void* operator new[](std::size_t bytes) {
    if (bytes > (1U << 16U)) throw std::bad_alloc();
    return ::operator new[](bytes);
  }
  static void operator delete[](void* memory) { ::operator delete[](memory); }
};

TEST(GrowingPairs, KnowTheirSizeAfterMemoryWasRefused) {
  cpu::GrowingPairs<Scarce> pairs;
  Scarce* out = pairs.room_for(2);
  *out++ = {3};
  pairs.commit(out);
  for (int k = 0; k < 2; ++k) EXPECT_THROW(static_cast<void>(pairs.room_for(1U << 20U)), std::bad_alloc);
  ASSERT_EQ(pairs.size(), 1U);
  EXPECT_EQ(pairs.begin()->value, 3U);
}

TEST(CollectPairs, CountsNothingPastTheLastTile) {
  const TestScene scene =
      testing::random_scene(testing::transfer_layout(), 400, {.scale_low = 0.005F, .scale_high = 0.05F}, 41);
  cpu::Frame frame = projected(scene, testing::test_camera(40, 24));
  ASSERT_GT(frame.visible, 100U);
  // One block of the last tile, whose neighbours are not in the picture; and no block at all from past the last tile
  // on, which is what a box that just touches the picture's lower edge leaves.
  const std::uint32_t last = frame.tile_count() - 1;
  frame.reaches[frame.order[0].gaussian] = {last, {1, 0}};
  frame.reaches[frame.order[1].gaussian] = {last + 1, {0, 0}};
  frame.reaches[frame.order[2].gaussian] = {last + frame.tiles_x, {0, 0}};
  GuardedCounters counters(frame.tile_count());
  cpu::PairBuffer pairs;
  cpu::collect_pairs(frame, 0, frame.visible, 0, 1U << 20U, pairs, counters.data());
  EXPECT_EQ(std::accumulate(counters.data(), counters.data() + frame.tile_count(), std::size_t{0}), pairs.size());
  EXPECT_EQ(frame.pair_ranges[frame.order[0].gaussian].count, 1U);
  EXPECT_EQ(frame.pair_ranges[frame.order[1].gaussian].count, 0U);
  EXPECT_EQ(frame.pair_ranges[frame.order[2].gaussian].count, 0U);
}

TEST(CollectPairs, EveryBlockThatIsReachedAndNoTileTwice) {
  // Ellipses of one tile to the whole picture, so that all ways of cutting them are taken.
  for (const auto& [low, high] : {std::pair{0.01F, 0.1F}, {0.05F, 0.3F}, {0.2F, 0.9F}}) {
    const TestScene scene = testing::random_scene(testing::transfer_layout(), 300,
                                                  {.spread = 1.5F, .scale_low = low, .scale_high = high}, 42);
    cpu::Frame frame = projected(scene, testing::test_camera(93, 70));
    GuardedCounters counters(frame.tile_count());
    cpu::PairBuffer pairs;
    cpu::collect_pairs(frame, 0, frame.visible, 0, 1U << 20U, pairs, counters.data());
    std::vector<std::uint32_t> counted(frame.tile_count());
    std::size_t needed = 0, listed = 0;
    for (std::size_t k = 0; k < frame.visible; ++k) {
      const std::uint32_t gaussian = frame.order[k].gaussian;
      SCOPED_TRACE(::testing::Message() << "Gaussian " << gaussian << ", scales " << low << " to " << high);
      const cpu::PairRange& range = frame.pair_ranges[gaussian];
      std::map<std::uint32_t, std::uint32_t> collected;
      for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
        const cpu::Pair& pair = pairs.begin()[i];
        ASSERT_LT(pair.tile, frame.tile_count());
        ASSERT_EQ(pair.gaussian_and_blocks & cpu::kGaussianMask, gaussian);
        ASSERT_TRUE(collected.emplace(pair.tile, pair.gaussian_and_blocks >> cpu::kBlockShift).second);
        ++counted[pair.tile];
        listed += static_cast<std::size_t>(std::popcount(pair.gaussian_and_blocks >> cpu::kBlockShift));
      }
      for (const auto& [tile, blocks] : blocks_by_search(frame, frame.splats[gaussian])) {
        ASSERT_EQ(blocks & ~collected[tile], 0U) << "tile " << tile;
        needed += static_cast<std::size_t>(std::popcount(blocks));
      }
    }
    for (std::uint32_t tile = 0; tile < frame.tile_count(); ++tile) EXPECT_EQ(counters.data()[tile], counted[tile]);
    // Rows of blocks are cut as bands, not at pixel centres, so a few more are listed.
    EXPECT_LE(static_cast<double>(listed), 1.3 * static_cast<double>(needed));
  }
}

TEST(CollectWidePairs, CountsNothingPastTheLastTile) {
  const TestScene scene =
      testing::random_scene(testing::transfer_layout(), 400, {.scale_low = 0.005F, .scale_high = 0.05F}, 41);
  cpu::Frame frame = projected(scene, testing::test_camera(40, 24), false);
  ASSERT_GT(frame.visible, 100U);
  const std::uint32_t last = frame.tile_count() - 1;
  frame.reaches[frame.order[0].gaussian] = {last, {1, 0}};
  frame.reaches[frame.order[1].gaussian] = {last + 1, {0, 0}};
  frame.reaches[frame.order[2].gaussian] = {last + frame.tiles_x, {0, 0}};
  GuardedCounters counters(frame.tile_count());
  cpu::WidePairBuffer pairs;
  cpu::collect_wide_pairs(frame, 0, 3, 1U << 20U, pairs, counters.data());
  ASSERT_EQ(pairs.size(), 1U);
  EXPECT_EQ(pairs.begin()->tile, last);
  EXPECT_EQ(counters.data()[last], 1U);
  EXPECT_EQ(std::accumulate(counters.data(), counters.data() + frame.tile_count(), 0U), 1U);
}

TEST(CollectWidePairs, EveryBlockThatIsReachedAndNoTileTwice) {
  for (const auto& [low, high] : {std::pair{0.01F, 0.1F}, {0.05F, 0.3F}, {0.2F, 0.9F}}) {
    const TestScene scene = testing::random_scene(testing::transfer_layout(), 300,
                                                  {.spread = 1.5F, .scale_low = low, .scale_high = high}, 42);
    cpu::Frame frame = projected(scene, testing::test_camera(93, 70), false);
    GuardedCounters counters(frame.tile_count());
    cpu::WidePairBuffer pairs;
    cpu::collect_wide_pairs(frame, 0, frame.visible, 1U << 20U, pairs, counters.data());
    std::vector<std::map<std::uint32_t, std::uint32_t>> collected(scene.count);
    std::vector<std::uint32_t> counted(frame.tile_count());
    std::size_t needed = 0, listed = 0;
    for (const cpu::WidePair& pair : pairs) {
      ASSERT_LT(pair.tile, frame.tile_count());
      ASSERT_LT(pair.gaussian, scene.count);
      ASSERT_TRUE(collected[pair.gaussian].emplace(pair.tile, pair.blocks).second);
      ++counted[pair.tile];
      listed += static_cast<std::size_t>(std::popcount(pair.blocks));
    }
    for (std::size_t k = 0; k < frame.visible; ++k) {
      const std::uint32_t gaussian = frame.order[k].gaussian;
      SCOPED_TRACE(::testing::Message() << "Gaussian " << gaussian << ", scales " << low << " to " << high);
      for (const auto& [tile, blocks] : blocks_by_search(frame, frame.splats[gaussian])) {
        ASSERT_EQ(blocks & ~collected[gaussian][tile], 0U) << "tile " << tile;
        needed += static_cast<std::size_t>(std::popcount(blocks));
      }
    }
    for (std::uint32_t tile = 0; tile < frame.tile_count(); ++tile) EXPECT_EQ(counters.data()[tile], counted[tile]);
    EXPECT_LE(static_cast<double>(listed), 1.3 * static_cast<double>(needed));
  }
}

}  // namespace
}  // namespace splatbus::raster
