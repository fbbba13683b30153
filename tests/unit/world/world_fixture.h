#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <bit>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "world/world.h"

namespace splatbus::world {

using Bytes = std::vector<unsigned char>;

inline Bytes read_bytes(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}
inline void write_bytes(const std::filesystem::path& path, const Bytes& bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

/// A folder of the test's own, and pages that nobody else would make.
class WorldTest : public testing::Test {
 protected:
  WorldTest() {
    // In memory where there is such a folder: bringing thousands of small files to a disk takes minutes.
    const std::filesystem::path memory = "/dev/shm";
    const auto base = std::filesystem::is_directory(memory) ? memory : std::filesystem::temp_directory_path();
    std::string name = (base / "splatbus-world-XXXXXX").string();
    folder_ = std::filesystem::path(::mkdtemp(name.data())) / "world";
  }
  ~WorldTest() override { std::filesystem::remove_all(folder_.parent_path()); }

  /// Like a live one: parameters near each other, an average near them, ids in a row.
  static Page make_page(std::uint64_t morton, std::uint32_t count, std::uint32_t seed) {
    std::mt19937 random(seed);
    std::normal_distribution<float> near(0, 0.01F);
    Page page{.key = {.frame_id = seed % 3, .level = 0, .morton = morton, .id = morton == 0 ? 0 : morton + 1},
              .count = count,
              .step = seed,
              .morton_last = morton + 5,
              .bounds = {.low = {-1, -2, -3}, .high = {1, 2, 3.5F}, .max_scale_m = 0.25F}};
    constexpr std::uint32_t kParameters = 41, kRows = 91;
    page.words.resize(std::size_t{kRows} * count);
    for (std::uint32_t row = 0; row < kRows - 2; ++row) {
      for (std::uint32_t i = 0; i < count; ++i) {
        const bool average = row >= kParameters && row < 2 * kParameters;
        const float value =
            average ? std::bit_cast<float>(page.words[(row - kParameters) * count + i]) : static_cast<float>(row);
        page.words[row * count + i] = std::bit_cast<std::uint32_t>(value + near(random));
      }
    }
    for (std::uint32_t i = 0; i < count; ++i) page.words[(kRows - 2) * count + 2 * i] = seed * 2000 + i;
    return page;
  }

  static void put(World& world, const Page& page) { world.put(page, encode_page(page, world.layout())); }

  static void expect_same(const Page& is, const Page& should) {
    EXPECT_EQ(is.key, should.key);
    EXPECT_EQ(is.count, should.count);
    EXPECT_EQ(is.step, should.step);
    EXPECT_EQ(is.morton_last, should.morton_last);
    EXPECT_EQ(is.state, should.state);
    EXPECT_EQ(is.mark, should.mark);
    EXPECT_EQ(is.bounds.low.y, should.bounds.low.y);
    EXPECT_EQ(is.bounds.high.z, should.bounds.high.z);
    EXPECT_EQ(is.bounds.max_scale_m, should.bounds.max_scale_m);
    EXPECT_TRUE(is.words == should.words);
  }

  static void expect_holds(World& world, const std::map<PageKey, Page>& truth) {
    ASSERT_EQ(world.pages().size(), truth.size());
    for (const auto& [key, page] : truth) {
      const auto found = world.read(key);
      ASSERT_TRUE(found);
      expect_same(*found, page);
    }
  }

  [[nodiscard]] std::filesystem::path segment(int number) const {
    std::string name = std::to_string(number);
    return folder_ / "segments" / (std::string(6 - name.size(), '0') + name + ".seg");
  }

  std::filesystem::path folder_;
};

}  // namespace splatbus::world
