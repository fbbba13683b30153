#include "trainer/buffer_pool.h"

#include <gtest/gtest.h>

#include <optional>
#include <thread>
#include <vector>

namespace splatbus::trainer {
namespace {

TEST(BufferPool, LendsWhatCameBackAgain) {
  BufferPool pool(bus::MemoryKind::Host);
  auto first = pool.take(5000);
  const std::byte* const address = first.get();
  const auto second = pool.take(5000);
  EXPECT_NE(second.get(), address);
  first.reset();
  EXPECT_EQ(pool.take(6000).get(), address) << "sizes are powers of two";
  EXPECT_NE(pool.take(100000).get(), address);
}

TEST(BufferPool, KeepsNoMoreIdleThanItsBound) {
  BufferPool pool(bus::MemoryKind::Host);
  constexpr std::size_t large = std::size_t{200} << 20;
  auto first = pool.take(large);
  auto second = pool.take(large);
  first.reset();
  second.reset();
  EXPECT_NE(pool.take(large), nullptr);
}

TEST(BufferPool, WhatItLendsOutlivesItAndComesBackOnAnyThread) {
  std::optional<BufferPool> pool(bus::MemoryKind::Host);
  auto lent = pool->take(10);
  std::thread([&, other = pool->take(10)]() mutable { other.reset(); }).join();
  pool.reset();
  lent.get()[9] = std::byte{1};
}

}  // namespace
}  // namespace splatbus::trainer
