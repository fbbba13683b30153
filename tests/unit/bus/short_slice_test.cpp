#include "bus/short_slice.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <thread>

#include "bus_fixture.h"

namespace splatbus::bus {
namespace {

/// Threads of this process whose slice is short.
int short_threads() {
  int count = 0;
  for (const auto& thread : std::filesystem::directory_iterator("/proc/self/task")) {
    count += slice_ns(std::stoi(thread.path().filename())) == ShortSlice::kSlice_ns ? 1 : 0;
  }
  return count;
}

class ShortSlices : public testing::Test {
 protected:
  void SetUp() override {
    if (slice_ns(0).value_or(0) == 0) GTEST_SKIP() << "this kernel has no slices";
    ASSERT_NE(slice_ns(0), ShortSlice::kSlice_ns);
  }
};

TEST_F(ShortSlices, AreOfTheThreadAndOfThoseThatItStarts) {
  const auto before = slice_ns(0);
  const int nice = ::getpriority(PRIO_PROCESS, 0);
  std::optional<std::uint64_t> started, later;
  {
    const ShortSlice slice;
    EXPECT_EQ(slice_ns(0), ShortSlice::kSlice_ns);
    EXPECT_EQ(::getpriority(PRIO_PROCESS, 0), nice) << "it has no more of the processor";
    std::thread([&] { started = slice_ns(0); }).join();
  }
  std::thread([&] { later = slice_ns(0); }).join();
  EXPECT_EQ(started, ShortSlice::kSlice_ns);
  EXPECT_EQ(slice_ns(0), before);
  EXPECT_EQ(later, before);
}

TEST_F(ShortSlices, AreThoseOfWhatCarriesMessages) {
  const int before = short_threads();
  const bus_test::TemporaryDirectory folder;
  bus_service::BrokerOptions options;
  options.address = folder.address();
  bus_service::Broker broker(options);
  broker.start();
  const int of_broker = short_threads() - before;
  EXPECT_GE(of_broker, 4) << "its own, and ZeroMQ's two";
  const auto context = Context::create(folder.address(), "somebody");
  EXPECT_GE(short_threads() - before - of_broker, 3) << "ZeroMQ's two, and the one that publishes";
  EXPECT_NE(slice_ns(0), ShortSlice::kSlice_ns) << "nor is it the caller's";
}

}  // namespace
}  // namespace splatbus::bus
