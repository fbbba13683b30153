// Those who ask for pages without being viewers.
#include "streamer/page_readers.h"

#include <gtest/gtest.h>

namespace splatbus::streamer {
namespace {

constexpr std::int64_t kSecondNs = 1'000'000'000;

TEST(PageReaders, EachHasItsRate) {
  PageReaders readers;
  EXPECT_TRUE(readers.take("a", 500, kSecondNs));
  EXPECT_FALSE(readers.take("a", 1, kSecondNs));
  EXPECT_TRUE(readers.take("b", 500, kSecondNs)) << "another one's affair";
  EXPECT_FALSE(readers.take("a", 251, kSecondNs + kSecondNs / 2));
  EXPECT_TRUE(readers.take("a", 250, kSecondNs + kSecondNs / 2));
  EXPECT_FALSE(readers.take("c", 501, kSecondNs)) << "more than there ever is";
}

TEST(PageReaders, TheyAreFewAndForgotten) {
  PageReaders readers;
  EXPECT_TRUE(readers.empty());
  for (std::size_t i = 0; i < PageReaders::kMaxReaders; ++i) EXPECT_TRUE(readers.take(std::to_string(i), 1, kSecondNs));
  EXPECT_FALSE(readers.take("one too many", 1, kSecondNs));
  const std::int64_t later_ns = kSecondNs + PageReaders::kForgetNs;
  EXPECT_FALSE(readers.expire(later_ns)) << "not longer than that";
  EXPECT_TRUE(readers.take("0", 1, later_ns));
  EXPECT_FALSE(readers.expire(later_ns + 1)) << "one is left";
  EXPECT_FALSE(readers.empty());
  EXPECT_TRUE(readers.take("one more", 1, later_ns + 1));
  EXPECT_TRUE(readers.expire(later_ns + 2 + PageReaders::kForgetNs));
  EXPECT_TRUE(readers.empty());
}

}  // namespace
}  // namespace splatbus::streamer
