// The bridge on the device, between an engine and a reader on the bus.
#include "../../bus/bus_fixture.h"
#include "capture-bridge/capture_bridge.h"
#include "capture-bridge/parameters.h"
#include "cuda_rounds.h"
#include "fake_engine.h"
#include "wire/capture_generated.h"

namespace splatbus::capture_bridge::test {
namespace {

using namespace std::chrono_literals;

constexpr std::uint64_t kInputBytes = std::uint64_t{4} * 32 * 32 * (16 + 16 + 4 + 4 + 4);
constexpr std::uint64_t kLightBytes = std::uint64_t{16} * 16 * 4;

class CudaBridgeTest : public bus_test::BusTest {
 protected:
  void SetUp() override {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
    for (const auto& [name, value] : {std::pair{"input_cameras", "4"}, std::pair{"input_size", "32"},
                                      std::pair{"reference_cameras", "2"}, std::pair{"reference_size", "16"},
                                      std::pair{"reference_rate_hz", "0"}, std::pair{"light_depth_size", "16"}}) {
      ASSERT_EQ(parameters_.set(name, value, true), "");
    }
  }

  /// One round of an engine whose pictures lie in `engine_memory`, through a bridge: its input and its light's depth.
  void capture(Device engine_memory, Device backend, std::uint32_t claimed_rows = 1) {
    const auto peer = connect("peer");
    bus::Subscriber reader(peer, {"capture/*", "scene/*"});
    FakeEngine engine(connect("engine"), engine_memory);
    engine.claimed_rows = claimed_rows;
    const auto context = connect("capture-bridge");
    CaptureBridge bridge(context, parameters_, backend);
    ASSERT_TRUE(bus_test::eventually([&] {
      bridge.step(1ms);
      engine.serve();
      while (auto message = reader.receive(0ms)) {
        // A bridge before this one may have latched its own.
        if (message->header().epoch() == context->epoch()) received_.insert_or_assign(message->topic(), *message);
      }
      return received_.contains("capture/input") && received_.contains("scene/light_depth") &&
             received_.contains("capture/reference");
    }));
    host_copied_bytes_ = bridge.host_copied_bytes();
    light_bytes_ = engine.light_maps_drawn * kLightBytes;
    refused_ = bridge.counters().refused;
    for (const char* name : {"position", "normal", "albedo", "color", "spacing"}) {
      const auto tensor = received_.at("capture/input").tensor(name);
      ASSERT_TRUE(tensor) << name;
      EXPECT_EQ(tensor->memory(), backend) << name;
      auto& values = tensors_[backend][name];
      values.resize(tensor->elements());
      ASSERT_TRUE(tensor->copy(values.data())) << name;
    }
    const auto light_depth = received_.at("scene/light_depth").tensor("light_depth", bus::ElementType::F32, {16, 16});
    ASSERT_TRUE(light_depth);
    EXPECT_EQ(light_depth->memory(), backend);
    std::vector<float> depth(light_depth->elements());
    ASSERT_TRUE(light_depth->copy(depth.data()));
    EXPECT_EQ(depth, std::vector<float>(256, 7.0F));
    const auto color = received_.at("capture/reference").tensor("color");
    ASSERT_TRUE(color);
    EXPECT_EQ(color->memory(), engine_memory) << "forwarded, not copied";
    received_.clear();
  }

  bus::Parameters parameters_{bus::Parameters::declare<Options>()};
  std::map<std::string, bus::Message> received_;
  std::map<Device, std::map<std::string, std::vector<float>>> tensors_;
  std::uint64_t host_copied_bytes_ = 0, light_bytes_ = 0, refused_ = 0;
};

TEST_F(CudaBridgeTest, KeepsADevicesPicturesOnTheDevice) {
  capture(Device::Cuda, Device::Cuda);
  EXPECT_EQ(host_copied_bytes_, 0U);
}

TEST_F(CudaBridgeTest, UploadsAndCountsAHostsPictures) {
  capture(Device::Cpu, Device::Cuda);
  EXPECT_EQ(host_copied_bytes_, kInputBytes + light_bytes_);
}

TEST_F(CudaBridgeTest, OnTheCpuReadsADevicesPictures) {
  capture(Device::Cuda, Device::Cpu);
  EXPECT_EQ(host_copied_bytes_, kInputBytes + light_bytes_);
  capture(Device::Cuda, Device::Cuda);
  EXPECT_EQ(tensors_[Device::Cuda], tensors_[Device::Cpu]);
}

TEST_F(CudaBridgeTest, FramesThatClaimMoreMemoryThanThereIsAreRefused) {
  capture(Device::Cuda, Device::Cuda);
  EXPECT_EQ(refused_, 0U);
  const auto sound = tensors_;
  // Each good frame comes behind one whose pictures would reach far beyond the slab.
  capture(Device::Cuda, Device::Cuda, 128);
  EXPECT_GE(refused_, 6U) << "4 input cameras, a reference camera and a light";
  EXPECT_EQ(tensors_, sound);
}

}  // namespace
}  // namespace splatbus::capture_bridge::test
