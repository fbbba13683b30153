#include "bus/memory.h"

#include <gmock/gmock.h>

#include <numeric>
#include <tuple>
#include <vector>

#include "bus/backend.h"
#include "bus/error.h"
#include "bus/tensor_ring.h"
#include "bus_fixture.h"

namespace splatbus::bus_test {
namespace {

using testing::HasSubstr;
using testing::ThrowsMessage;

bool has_device() {
  return bus::choose_backend("auto") == Device::Cuda;
}

TEST(Backends, AreChosenByName) {
  EXPECT_EQ(bus::choose_backend("cpu"), Device::Cpu);
  EXPECT_THAT([] { (void)bus::choose_backend("vulkan"); }, ThrowsMessage<bus::Error>(HasSubstr("vulkan")));
  if (has_device()) {
    EXPECT_EQ(bus::choose_backend("cuda"), Device::Cuda);
  } else {
    EXPECT_THAT([] { (void)bus::choose_backend("cuda"); }, ThrowsMessage<bus::Error>(HasSubstr("no backend cuda: ")));
  }
}

TEST(Memory, OnAMachineWithoutADeviceIsOnlyTheHosts) {
  if (has_device()) GTEST_SKIP() << "there is a device";
  EXPECT_THROW((void)bus::allocate_memory(Device::Cuda, 16), bus::Error);
  const auto memory = bus::allocate_memory(Device::Cpu, 3);
  EXPECT_EQ(memory.get()[2], std::byte{0});
}

/// Where the ring's slab lies, where what is written to it lies, and where a reader wants it.
using Kinds = std::tuple<Device, Device, Device>;

class TensorsInAnyMemory : public BusTest, public testing::WithParamInterface<Kinds> {
 protected:
  void SetUp() override {
    const auto [ring, source, reader] = GetParam();
    const bool device = ring == Device::Cuda || source == Device::Cuda || reader == Device::Cuda;
    if (device && !has_device()) GTEST_SKIP() << "no CUDA device";
  }

  /// A copy of values in memory of a kind, and back.
  static std::shared_ptr<std::byte> place(Device kind, const std::vector<float>& values) {
    auto memory = bus::allocate_memory(kind, values.size() * sizeof(float));
    bus::copy_memory(memory.get(), kind, values.data(), Device::Cpu, values.size() * sizeof(float));
    bus::finish_copies();
    return memory;
  }
  static std::vector<float> fetch(Device kind, const std::byte* memory, std::size_t count) {
    std::vector<float> values(count);
    bus::copy_memory(values.data(), Device::Cpu, memory, kind, count * sizeof(float));
    bus::finish_copies();
    return values;
  }
};

TEST_P(TensorsInAnyMemory, ArriveWholeAndAreCounted) {
  const auto [ring_kind, source_kind, reader_kind] = GetParam();
  std::vector<float> first(1000), second(77);
  std::iota(first.begin(), first.end(), 1.0F);
  std::iota(second.begin(), second.end(), 5000.0F);
  const auto first_memory = place(source_kind, first), second_memory = place(source_kind, second);

  const auto maker = connect("maker");
  bus::TensorRing ring(maker, "frames", 2, 0, ring_kind);
  const std::vector<bus::TensorSource> sources{
      {.name = "first", .shape = {1000}, .data = first_memory.get(), .memory = source_kind},
      {.name = "second", .shape = {7, 11}, .data = second_memory.get(), .memory = source_kind}};
  const auto tensors = ring.write(sources);

  const auto slab = connect("reader")->open_slab(tensors[1].span.slab());
  ASSERT_NE(slab, nullptr);
  const bus::TensorView view("second", {7, 11}, bus::ElementType::F32, slab, tensors[1].span);
  EXPECT_EQ(view.memory(), ring_kind);
  const auto destination = bus::allocate_memory(reader_kind, view.bytes());
  std::atomic<std::uint64_t> host_bytes{0};
  ASSERT_TRUE(bus::copy_tensor(view, destination.get(), reader_kind, host_bytes));
  EXPECT_EQ(fetch(reader_kind, destination.get(), 77), second);
  const bool stayed = ring_kind == Device::Cuda && reader_kind == Device::Cuda;
  EXPECT_EQ(host_bytes.load(), stayed ? 0 : view.bytes());

  (void)ring.write(sources);
  EXPECT_TRUE(bus::copy_tensor(view, destination.get(), reader_kind, host_bytes));
  (void)ring.write(sources);  // the slot's second turn
  EXPECT_FALSE(bus::copy_tensor(view, destination.get(), reader_kind, host_bytes));
}

constexpr auto kAnyKind = {Device::Cpu, Device::Cuda};
INSTANTIATE_TEST_SUITE_P(AllKinds, TensorsInAnyMemory,
                         testing::Combine(testing::ValuesIn(kAnyKind), testing::ValuesIn(kAnyKind),
                                          testing::ValuesIn(kAnyKind)));

}  // namespace
}  // namespace splatbus::bus_test
