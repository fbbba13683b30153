// The quantizer of device memory against that of host memory: the same integers, the same packets.
#include <cuda_runtime_api.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <optional>
#include <random>

#include "device/buffer.h"
#include "device/stream.h"
#include "shown_replica.h"
#include "stream/model_quantizer.h"
#include "stream/replica.h"
#include "toy_server.h"

namespace splatbus::stream {
namespace {

/// A model copied to the device, as a trainer would have it there: more columns than Gaussians.
class DeviceModel {
 public:
  GaussiansView copy(const GaussiansBuffer& host) {
    GaussiansView view = host.view();
    view.parameters = upload(parameters_, host.parameters);
    view.normal = upload(normal_, host.normal);
    view.visibility = upload(visibility_, host.visibility);
    view.object_id = upload(object_id_, host.object_id);
    view.gaussian_id = upload(gaussian_id_, host.gaussian_id);
    stream_.wait();
    return view;
  }

 private:
  template <class T>
  const T* upload(device::Buffer<T>& to, const std::vector<T>& from) {
    to.upload(from.data(), from.size(), stream_.get());
    return to.data();
  }

  device::Stream stream_;
  device::Buffer<float> parameters_, normal_, visibility_;
  device::Buffer<std::uint32_t> object_id_;
  device::Buffer<std::uint64_t> gaussian_id_;
};

struct Case {
  Appearance appearance;
  std::size_t count;
};

std::string case_name(const testing::TestParamInfo<Case>& info) {
  return std::string(info.param.appearance == Appearance::Transfer ? "Transfer" : "Radiance") +
         std::to_string(info.param.count);
}

class CudaQuantizer : public testing::TestWithParam<Case> {
 protected:
  void SetUp() override {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
    device_.emplace();
    server_ = std::make_unique<test::ToyServer>(11, GetParam().count, GetParam().appearance);
    twin_ = std::make_unique<StreamModel>(PacketWriter("streamer", 1), 77, StreamOptions{}, Device::Cuda);
    EXPECT_FALSE(twin_->take_scene(server_->scene, {}));
    ASSERT_TRUE(twin_->observe(device_->copy(server_->model())));
    twin_->reset_to_target();
    const auto relit = server_->relit();
    (void)twin_->take_visibility(test::ToyServer::of_sun(relit, server_->scene.version));
    expect_same();
  }

  /// One tick of both.
  void tick(double budget = 1e9) {
    const std::vector<EncodedPacket> expected = server_->tick(budget);
    ASSERT_TRUE(twin_->observe(device_->copy(server_->model())));
    twin_->make_tick(budget, {});
    std::vector<EncodedPacket> actual = test::packets_of(*twin_);
    const auto relit = server_->relit();
    for (auto& packet : twin_->take_visibility(test::ToyServer::of_sun(relit, server_->scene.version))) {
      actual.push_back(std::move(packet.packet));
    }
    ASSERT_EQ(actual.size(), expected.size());
    for (std::size_t i = 0; i < actual.size(); ++i) {
      // The rest of a packet's header is the time.
      ASSERT_EQ(actual[i].body, expected[i].body);
      ASSERT_EQ(actual[i].sequence, expected[i].sequence);
      ASSERT_EQ(actual[i].packet.size(), expected[i].packet.size());
      ASSERT_EQ(actual[i].payload, expected[i].payload) << wire::EnumNameBody(actual[i].body);
    }
    expect_same();
  }

  void expect_same() {
    const QuantizedGaussians &actual = twin_->observed_gaussians(), &expected = server_->stream.observed_gaussians();
    ASSERT_EQ(actual.count(), expected.count());
    ASSERT_EQ(actual.channels.size(), expected.channels.size());
    for (std::size_t c = 0; c < actual.channels.size(); ++c) {
      std::size_t apart = 0;
      for (std::size_t i = 0; i < actual.count(); ++i)
        apart += actual.channels[c][i] != expected.channels[c][i] ? 1 : 0;
      EXPECT_EQ(apart, 0U) << "of " << actual.count() << " in channel " << c;
    }
    EXPECT_EQ(actual.object_id, expected.object_id);
    EXPECT_EQ(actual.gaussian_id, expected.gaussian_id);
    EXPECT_EQ(twin_->held().layout, server_->stream.held().layout);
    EXPECT_EQ(twin_->held().gaussians, server_->stream.held().gaussians);
  }

  std::unique_ptr<test::ToyServer> server_;
  std::unique_ptr<StreamModel> twin_;
  std::optional<DeviceModel> device_;
};

TEST_P(CudaQuantizer, FollowsATrainedModelBitForBit) {
  for (int round = 0; round < 12; ++round) {
    if (round % 3 == 0) server_->insert(GetParam().count / 5 + 1);
    if (round % 4 == 1) server_->remove(GetParam().count / 9);
    // From much that changes to little.
    server_->train(round < 4 ? 0.05F : 0.0003F);
    tick(round % 2 == 0 ? 1e9 : 2e4);
    if (HasFatalFailure()) return;
  }
}

TEST_P(CudaQuantizer, LeavesOutWhatIsNotFinite) {
  GaussiansBuffer& model = server_->model();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const std::size_t channel = model.layout().channels() - 1;
  for (std::size_t i = 0; i < model.count(); i += 7) model.parameters[channel * model.stride() + i] = nan;
  model.parameters[1] = std::numeric_limits<float>::infinity();
  model.parameters[ParameterLayout::kLogScale * model.stride() + 2] = -3e38F;
  tick();
  for (std::size_t i = 0; i < model.count(); i += 7) model.parameters[channel * model.stride() + i] = 0.25F;
  tick();
}

TEST_P(CudaQuantizer, AnObservationThatWasTornLeavesNothingBehind) {
  server_->train(0.05F);
  GaussiansBuffer torn = server_->model();
  torn.gaussian_id[0] = 99999;
  torn.object_id[1] = 4;
  torn.parameters[0] = std::numeric_limits<float>::quiet_NaN();
  for (float& value : torn.parameters) value += 0.5F;
  const QuantizedGaussians before = twin_->observed_gaussians();
  EXPECT_FALSE(twin_->observe(device_->copy(torn), [] { return false; }));
  EXPECT_EQ(twin_->observed_gaussians(), before);
  tick();
}

TEST_P(CudaQuantizer, BringsOverLittleOfWhatRests) {
  tick();
  const std::uint64_t before = twin_->quantizer().copied_bytes();
  tick();
  EXPECT_EQ(twin_->quantizer().copied_bytes(), before);
  server_->model().parameters[0] += 1.0F;
  tick();
  EXPECT_LE(twin_->quantizer().copied_bytes() - before, 64U);
}

/// A row of a view on the device.
template <class T>
std::vector<T> brought(const T* row, std::size_t count) {
  std::vector<T> host(count);
  const device::StreamView stream{.device = Device::Cuda};
  device::copy(stream, host.data(), row, count * sizeof(T));
  stream.wait();
  return host;
}

/// Of the rows that hold Gaussians.
void expect_rows_near(const float* device, const float* host, const GaussiansView& view, const char* what) {
  const std::vector<float> actual = brought(device, view.count);
  for (const IndexRange& range : view.ranges) {
    for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
      ASSERT_NEAR(actual[i], host[i], 1e-5F * std::max(1.0F, std::abs(host[i]))) << what << " of row " << i;
    }
  }
}

template <class T>
void expect_rows_equal(const T* device, const T* host, const GaussiansView& view, const char* what) {
  const std::vector<T> actual = brought(device, view.count);
  for (const IndexRange& range : view.ranges) {
    for (std::uint32_t i = range.first; i < range.first + range.count; ++i) {
      ASSERT_EQ(actual[i], host[i]) << what << " of row " << i;
    }
  }
}

TEST_P(CudaQuantizer, AReplicaOnTheDeviceShowsWhatOneOnTheHostShows) {
  test::ShownReplica host, device(kMaxGaussians, Device::Cuda);
  const auto both = [&](const auto& packets) {
    test::send(packets, host);
    test::send(packets, device);
  };
  test::join(server_->stream, host);
  test::join(server_->stream, device);
  for (int round = 0; round < 6; ++round) {
    if (round % 2 == 0) server_->insert(GetParam().count / 5 + 1);
    if (round % 3 == 1) server_->remove(GetParam().count / 9);
    server_->train(0.02F);
    server_->scene.light.sources.resize(static_cast<std::size_t>(round % 3));
    for (std::uint32_t k = 0; k < server_->scene.light.sources.size(); ++k) {
      server_->scene.light.sources[k] = {.id = 3 + k, .intensity = {1, 1, 1}};
    }
    both(server_->tick(round % 2 == 0 ? 1e9 : 2e4));
    test::send_pages(server_->stream, host);
    test::send_pages(server_->stream, device);
    const std::vector<std::uint32_t> lights{0, 3};
    std::vector<std::uint8_t> seen(2 * server_->model().count());
    for (std::size_t i = 0; i < seen.size(); ++i) seen[i] = static_cast<std::uint8_t>(i * (round + 1) % 251);
    if (GetParam().appearance == Appearance::Transfer) {
      both(server_->stream.take_visibility(
          {.light_ids = lights, .of_index = seen, .scene_version = server_->scene.version + round}));
    }
    const GaussiansView want = host.view(), got = device.view();
    ASSERT_GT(want.count, 0U);
    ASSERT_EQ(got.count, want.count);
    ASSERT_TRUE(std::ranges::equal(got.ranges, want.ranges));
    for (int c = 0; c < want.layout.channels(); ++c) expect_rows_near(got.plane(c), want.plane(c), want, "a channel");
    for (std::size_t c = 0; want.normal != nullptr && c < 3; ++c) {
      expect_rows_near(got.normal + c * got.stride, want.normal + c * want.stride, want, "the normal");
    }
    if (want.visibility != nullptr) expect_rows_near(got.visibility, want.visibility, want, "the visibility");
    ASSERT_EQ(got.visibility_u8 != nullptr, want.visibility_u8 != nullptr);
    for (std::uint32_t k = 0; want.visibility_u8 != nullptr && k < want.visibility_rows; ++k) {
      ASSERT_EQ(got.visibility_rows, want.visibility_rows);
      expect_rows_equal(got.visibility_u8 + k * got.visibility_stride, want.visibility_u8 + k * want.visibility_stride,
                        want, "what is seen");
    }
    expect_rows_equal(got.object_id, want.object_id, want, "the object");
  }
}

INSTANTIATE_TEST_SUITE_P(Appearances, CudaQuantizer,
                         testing::Values(Case{Appearance::Transfer, 600}, Case{Appearance::Radiance, 600},
                                         Case{Appearance::Transfer, 20'000}, Case{Appearance::Radiance, 20'000}),
                         case_name);

TEST(CudaQuantizerOfALargeModel, SeesWhatTheHostSees) {
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) GTEST_SKIP() << "no CUDA device";
  GaussiansBuffer model = test::toy_model(200'000, 3);
  DeviceModel device;
  StreamModel host(PacketWriter("streamer", 1), 77);
  StreamModel cuda(PacketWriter("streamer", 1), 77, {}, Device::Cuda);
  const auto observe = [&] {
    EXPECT_TRUE(host.observe(model.view()));
    EXPECT_TRUE(cuda.observe(device.copy(model)));
    EXPECT_EQ(host.observed_gaussians(), cuda.observed_gaussians());
  };
  observe();
  host.reset_to_target();
  cuda.reset_to_target();
  for (float& value : model.parameters) value += 0.02F;
  observe();
  std::mt19937 random(5);
  for (int k = 0; k < 100'000; ++k) model.parameters[random() % model.parameters.size()] += 0.01F;
  observe();
}

}  // namespace
}  // namespace splatbus::stream
