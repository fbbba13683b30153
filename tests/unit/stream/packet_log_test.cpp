#include "stream/packet_log.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace splatbus::stream {
namespace {

/// The most memory that this process has ever had, bytes.
std::size_t peak_bytes() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    std::size_t kilobytes = 0;
    if (word == "VmHWM:" && status >> kilobytes) return kilobytes * 1024;
  }
  return 0;
}

TEST(PacketLog, AClaimBeyondTheFilesEndCostsNoMemory) {
  const auto path = std::filesystem::temp_directory_path() / ("packet-log-" + std::to_string(::getpid()));
  {
    PacketLog log(path.string());
    log.add(Bytes{1, 2, 3}, Bytes{4});
    std::ofstream(path, std::ios::binary | std::ios::app) << std::string("\x01\0\0\0\0\0\0\x10", 8) << "x";
  }
  const std::size_t before = peak_bytes();
  PacketLogReader reader(path.string());
  const auto first = reader.next();
  ASSERT_TRUE(first.has_value());
  EXPECT_EQ(first->packet, (Bytes{1, 2, 3}));
  EXPECT_EQ(first->payload, (Bytes{4}));
  EXPECT_FALSE(reader.next().has_value()) << "256 MiB that are not there";
  EXPECT_LT(peak_bytes(), before + (std::size_t{64} << 20U));
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace splatbus::stream
