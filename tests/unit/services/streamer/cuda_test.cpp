// The streamer with its models and pictures in either kind of memory.
#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <random>

#include "bus/tensor_ring.h"
#include "stream_fixture.h"
#include "wire/capture_generated.h"

namespace splatbus::stream_test {
namespace {

using viewer::StreamClient;

struct Memories {
  Device backend;
  Device peers;
};

class Pipeline : public StreamTest {
 public:
  explicit Pipeline(const Memories& memories)
      : StreamTest(memories.peers),
        bridge_(connect("capture-bridge")),
        pictures_(bridge_, "probe", 4, 0, memories.peers) {
    start_streamer({}, memories.backend);
  }
  void TestBody() override {}
  void follow();
  void answer_probe();

 private:
  std::shared_ptr<bus::Context> bridge_;
  bus::TensorRing pictures_;
};

void Pipeline::follow() {
  GaussiansBuffer model = stream::test::toy_model(700, 1);
  trainer_.publish(model);
  StreamClient client(client_options("one"));
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 700; }, client));
  std::mt19937 random(3);
  std::normal_distribution<float> normal(0, 0.05F);
  for (int round = 0; round < 5; ++round) {
    for (float& value : model.parameters) value += normal(random);
    trainer_.publish(model);
    const auto near = [&] {
      // Of each Gaussian the nearest mean that is shown is its own.
      const stream::ReplicatedState& held = client.replica().held();
      const stream::Quantizer& mean = held.layout.at(stream::Attribute::Mean).quantizer;
      std::vector<float> want(model.parameters.begin(), model.parameters.begin() + 700), got;
      for (const auto& [number, page] : held.pages) {
        for (std::uint32_t lane = 0; lane < page.count; ++lane) {
          got.push_back(mean.offset + mean.step * static_cast<float>(held.gaussians.channels[0][page.row(lane)]));
        }
      }
      std::ranges::sort(want);
      std::ranges::sort(got);
      return std::ranges::equal(want, got, [](float a, float b) { return std::abs(a - b) < 0.01F; });
    };
    EXPECT_TRUE(poll_until(near, client)) << "round " << round;
  }
  EXPECT_EQ(client.refused(), 0U);
  EXPECT_EQ(client.lacked(), 0U);
}

void Pipeline::answer_probe() {
  trainer_.publish(stream::test::toy_model(100, 1));
  viewer::ClientOptions options = client_options("one");
  options.probes = true;
  StreamClient client(options);
  ASSERT_TRUE(poll_until([&] { return client.replica().count() == 100; }, client));
  const Camera camera = look_at({0, 1, 2}, {0, 0, 0}, 32, 16, 1.0F);
  std::vector<std::uint8_t> rgba(std::size_t{32} * 16 * 4);
  std::iota(rgba.begin(), rgba.end(), std::uint8_t{0});
  bus::Publisher answers(bridge_);
  const bus::TensorSource source{
      .name = "color", .shape = {16, 32, 4}, .type = bus::ElementType::U8, .data = rgba.data()};
  std::optional<viewer::ProbeAnswer> answer;
  EXPECT_TRUE(poll_until(
      [&] {
        answers.publish(
            topics::kCaptureProbe, {.tensors = pictures_.write({&source, 1})}, [&](auto& builder, auto header) {
              const auto wire_camera = to_wire(camera);
              return wire::CreateCaptureProbe(builder, header, 9, &wire_camera, to_wire(builder, SceneState{}, 1));
            });
        return (answer = client.take_probe_answer()).has_value();
      },
      client));
  ASSERT_TRUE(answer);
  EXPECT_EQ(answer->rgba, rgba);
}

class StreamerOnDevice : public testing::TestWithParam<Memories> {
 protected:
  void SetUp() override {
    if (bus::choose_backend("auto") != Device::Cuda) GTEST_SKIP() << "no CUDA device";
  }
};

TEST_P(StreamerOnDevice, AViewerFollowsTheModel) {
  Pipeline(GetParam()).follow();
}

TEST_P(StreamerOnDevice, PicturesOfProbesLeaveTheMachine) {
  Pipeline(GetParam()).answer_probe();
}

INSTANTIATE_TEST_SUITE_P(Memories, StreamerOnDevice,
                         testing::Values(Memories{Device::Cuda, Device::Cuda}, Memories{Device::Cuda, Device::Cpu},
                                         Memories{Device::Cpu, Device::Cuda}));

}  // namespace
}  // namespace splatbus::stream_test
