// The CUDA backend against the CPU one, and the service with its data in either kind of memory.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "ball_scene.h"
#include "bus/backend.h"
#include "bus/memory.h"
#include "relight_fixture.h"

namespace splatbus::relight {
namespace {

using test::BallOverFloor;
using test::RelightTest;

bool no_device() {
  return bus::choose_backend("auto") != Device::Cuda;
}

/// Arrays in device memory for as long as this lives.
class OnDevice {
 public:
  template <class T>
  const T* copy(const T* host, std::size_t elements) {
    const auto memory = bus::allocate_memory(Device::Cuda, elements * sizeof(T));
    bus::copy_memory(memory.get(), Device::Cuda, host, Device::Cpu, elements * sizeof(T));
    bus::finish_copies();
    owned_.push_back(memory);
    return reinterpret_cast<const T*>(memory.get());
  }
  GaussiansView copy(const GaussiansBuffer& host) {
    GaussiansView view = host.view();
    view.parameters = copy(host.parameters.data(), host.parameters.size());
    view.surface_point = copy(host.surface_point.data(), host.surface_point.size());
    view.normal = copy(host.normal.data(), host.normal.size());
    view.object_id = copy(host.object_id.data(), host.object_id.size());
    return view;
  }

 private:
  std::vector<std::shared_ptr<std::byte>> owned_;
};

/// Gaussians all over the scene, some without sense.
GaussiansBuffer random_gaussians(std::size_t count) {
  std::mt19937 random(3);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform(-2.0F, 2.0F);
  std::vector<glm::vec3> points, normals;
  for (std::size_t i = 0; i < count; ++i) {
    const bool on_floor = i % 2 == 0;
    const glm::vec3 direction = glm::normalize(glm::vec3(normal(random), normal(random), normal(random)));
    points.push_back(on_floor ? glm::vec3(uniform(random), 0, uniform(random))
                              : test::kBallCentre + test::kBallRadius_m * direction);
    normals.push_back(on_floor ? glm::vec3(0, 1, 0) : direction);
  }
  const float nan = std::numeric_limits<float>::quiet_NaN();
  points[0].x = nan;
  normals[1].y = nan;
  points[2] = glm::vec3(1e30F);
  points[3].x = 50;
  points[4].y = std::numeric_limits<float>::infinity();
  GaussiansBuffer gaussians = BallOverFloor::gaussians(points, normals);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      gaussians.parameters[(ParameterLayout::kLogScale + c) * gaussians.stride() + i] = -5.0F + 1.5F * normal(random);
    }
    gaussians.object_id[i] = static_cast<std::uint32_t>(i % 5);
  }
  gaussians.parameters[ParameterLayout::kLogScale * gaussians.stride() + 6] = nan;
  gaussians.parameters[ParameterLayout::kLogScale * gaussians.stride() + 7] = 80.0F;
  return gaussians;
}

/// The sun, a lamp, a light without shadow, and one whose earlier row is kept.
TEST(CudaVisibility, IsThatOfTheCpu) {
  if (no_device()) GTEST_SKIP() << "no CUDA device";
  const BallOverFloor scene(glm::vec3(0.5F, 1, 0.3F), 1024);
  const glm::vec3 position(0.9F, 1.7F, 0.2F);
  const auto faces = scene.faces(position, 256);
  const GaussiansBuffer gaussians = random_gaussians(200'000);
  ObjectTransform scaled(Rigid{.translation = {0.5F, 0.01F, -0.2F}});
  scaled.scale = 1.3F;
  const ObjectTransforms objects{{2, Rigid{.rotation = glm::normalize(glm::quat(1, 0.1F, 0.2F, -0.1F))}}, {3, scaled}};
  const std::size_t count = gaussians.count();
  std::vector<MappedLight> lights{scene.sun(), {.source = {.id = 4, .position = position, .range_m = 4}, .maps = {}}};
  for (const test::HostMap& face : faces) lights[1].maps.push_back(face.view());
  lights.push_back({.source = {.id = 5, .casts_shadow = false}, .maps = {}});
  lights.push_back({.source = {.id = 6}, .maps = {}});
  const std::vector<std::uint8_t> earlier(count, 77);
  const std::vector<std::int32_t> row{-1, -1, -1, 0};
  const std::vector<std::uint64_t> kept_of_page{8};
  KeptRows kept{.values = earlier.data(), .stride = count, .row = row, .lights_of_page = kept_of_page};
  std::vector<std::uint8_t> expected(lights.size() * count), actual(expected.size());
  compute_visibility({}, gaussians.view(), objects, lights, {}, expected.data(), kept);

  OnDevice device;
  const GaussiansView view = device.copy(gaussians);
  for (MappedLight& light : lights) {
    for (LightDepthMap& map : light.maps) {
      map.depth_m = device.copy(map.depth_m, std::size_t{map.camera.width} * map.camera.height);
    }
  }
  kept.values = device.copy(earlier.data(), count);
  const auto memory = bus::allocate_memory(Device::Cuda, actual.size());
  auto* const visibility = reinterpret_cast<std::uint8_t*>(memory.get());
  compute_visibility(device::thread_stream(Device::Cuda), view, objects, lights, {}, visibility, kept);
  bus::copy_memory(actual.data(), Device::Cpu, visibility, Device::Cuda, actual.size());
  bus::finish_copies();

  for (std::size_t light = 0; light < lights.size(); ++light) {
    std::size_t apart = 0, partly = 0;
    for (std::size_t i = light * count; i < (light + 1) * count; ++i) {
      const int difference = std::abs(actual[i] - expected[i]);
      ASSERT_LE(difference, 77) << "light " << light << ", " << i << ": " << actual[i] << ", not " << expected[i];
      apart += difference > 1 ? 1 : 0;
      partly += expected[i] > 0 && expected[i] < 255 ? 1 : 0;
    }
    // Where the surface's plane meets the depth of a texel exactly, rounding decides.
    EXPECT_LE(apart, count / 2000) << light;
    EXPECT_GT(partly + (light < 2 ? 0 : count), count / 200) << light;
  }
  EXPECT_EQ(actual[3 * count], 77);
}

struct Memories {
  Device backend;
  Device peers;
};

/// Starts only where there is a device.
class RelightOnDevice : public testing::TestWithParam<Memories> {
 protected:
  class Pipeline : public RelightTest {
   public:
    explicit Pipeline(const Memories& m) : RelightTest(m.backend, m.peers) {}
    void TestBody() override {}
    using RelightTest::publish_depth;
    using RelightTest::publish_lie;
    using RelightTest::publish_model;
    using RelightTest::visibility;
  };
};

TEST_P(RelightOnDevice, FollowsModelLightAndObjects) {
  if (no_device()) GTEST_SKIP() << "no CUDA device";
  Pipeline pipeline(GetParam());
  pipeline.publish_lie(1);
  pipeline.publish_model(1);
  pipeline.publish_depth(1, -2.0F);
  EXPECT_EQ(pipeline.visibility(1, 1), (std::vector<float>{1, 0, 1}));
  pipeline.publish_depth(2, 2.0F);
  EXPECT_EQ(pipeline.visibility(1, 2), (std::vector<float>{1, 0, 0})) << "the object has moved under the roof";
  pipeline.publish_model(2, 2);
  EXPECT_EQ(pipeline.visibility(2, 2), (std::vector<float>{1, 0}));
}

INSTANTIATE_TEST_SUITE_P(Memories, RelightOnDevice,
                         testing::Values(Memories{Device::Cuda, Device::Cuda}, Memories{Device::Cuda, Device::Cpu},
                                         Memories{Device::Cpu, Device::Cuda}));

}  // namespace
}  // namespace splatbus::relight
