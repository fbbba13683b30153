#include "bus/memory_pool.h"

#include <gtest/gtest.h>

#include <cstring>
#include <optional>
#include <set>
#include <thread>
#include <vector>

namespace splatbus::bus {
namespace {

TEST(MemoryPool, LendsWhatCameBackAgain) {
  MemoryPool pool(Device::Cpu);
  auto first = pool.take(5000);
  const std::byte* const address = first.get();
  const auto second = pool.take(5000);
  EXPECT_NE(second.get(), address);
  std::memset(first.get(), 1, 5000);
  first.reset();
  EXPECT_EQ(pool.take(5100).get(), address) << "sizes that differ little share their memory";
  EXPECT_NE(pool.take(6000).get(), address);
  EXPECT_NE(pool.take(100000).get(), address);
}

TEST(MemoryPool, WhatIsReservedIsLent) {
  MemoryPool pool(Device::Cpu);
  pool.reserve(2, 1000);
  std::set<const std::byte*> first;
  {
    const auto a = pool.take(1000);
    const auto b = pool.take(1000);
    first = {a.get(), b.get()};
  }
  EXPECT_EQ(first.size(), 2U);
  EXPECT_TRUE(first.contains(pool.take(1000).get()));
}

TEST(MemoryPool, FreesWhatCameBackLongestAgo) {
  MemoryPool pool(Device::Cpu, 1 << 20);
  const auto idle_after = [&](std::size_t bytes) {
    static_cast<void>(pool.take(bytes));
    return pool.idle_bytes();
  };
  EXPECT_EQ(idle_after(512 << 10), 512U << 10);
  EXPECT_EQ(idle_after(256 << 10), 768U << 10);
  EXPECT_EQ(idle_after(768 << 10), 1U << 20) << "the first one is gone";
  EXPECT_EQ(idle_after(2 << 20), 1U << 20) << "too large to be kept, and no reason to free the others";
  pool.reserve(3, 1 << 20);
  EXPECT_EQ(pool.idle_bytes(), 3U << 20);
}

TEST(MemoryPool, WhatItLendsOutlivesItAndComesBackOnAnyThread) {
  std::optional<MemoryPool> pool(Device::Cpu);
  auto lent = pool->take(10);
  std::thread([&, other = pool->take(10)]() mutable { other.reset(); }).join();
  pool.reset();
  lent.get()[9] = std::byte{1};
}

}  // namespace
}  // namespace splatbus::bus
