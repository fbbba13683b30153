#include "terminal.h"

#include <gtest/gtest.h>

namespace splatbus::cli {
namespace {

TEST(PrefixedOutput, AlignsNames) {
  const PrefixedOutput output({"bus", "streamer"}, false);
  EXPECT_EQ(output.format("bus", "hello", false), "bus      | hello");
  EXPECT_EQ(output.format("streamer", "started", true), "streamer * started");
}

TEST(PrefixedOutput, ColoursDiffer) {
  const PrefixedOutput output({"a", "b"}, true);
  EXPECT_EQ(output.format("a", "x", false), "\x1b[36ma |\x1b[0m x");
  EXPECT_EQ(output.format("b", "x", false), "\x1b[32mb |\x1b[0m x");
}

}  // namespace
}  // namespace splatbus::cli
