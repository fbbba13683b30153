#pragma once

#include "../../bus/bus_fixture.h"
#include "relight/relight.h"
#include "wire/convert.h"
#include "wire/model_generated.h"
#include "wire/scene_generated.h"

namespace splatbus::relight::test {

using namespace std::chrono_literals;

/// A relight of some backend on a bus, with a trainer and a capture bridge made by hand whose slabs are of some kind: a
/// sun straight above, and a roof over x > 0.
class RelightTest : public bus_test::BusTest {
 protected:
  static constexpr std::uint32_t kTexels = 64;
  static constexpr std::uint32_t kCapacity = 32;

  explicit RelightTest(Device backend = Device::Cpu, Device peers = Device::Cpu)
      : peer_(connect("peer")),
        subscriber_(peer_, {"relight/visibility"}),
        publisher_(peer_),
        planes_(peer_, "planes", 8, 0, peers),
        maps_(peer_, "maps", 8, 0, peers),
        service_(connect("relight"), parameters_, stop_.get_token(), backend),
        thread_([this] { Relight(service_).run(); }) {}

  ~RelightTest() override {
    stop_.request_stop();
    thread_.join();
  }

  /// Two Gaussians on the floor, at x = -1 and x = 1, and a third one of object 7 at its origin.
  void publish_model(std::uint64_t generation, std::uint64_t count = 3, std::uint32_t parameter_rows = 41) {
    const std::vector<float> parameters(std::size_t{41} * kCapacity, -4.0F);
    std::vector<float> normal(std::size_t{3} * kCapacity, 0.0F);
    std::vector<float> point(std::size_t{3} * kCapacity, 0.0F);
    const std::vector<float> ones(kCapacity, 1.0F);
    std::vector<std::uint32_t> object(kCapacity, 0);
    const std::vector<std::uint32_t> flags(kCapacity, 0);
    const std::vector<std::uint64_t> ids(kCapacity, 0);
    std::fill_n(normal.begin() + kCapacity, kCapacity, 1.0F);
    point[0] = -1.0F;
    point[1] = 1.0F;
    object[2] = 7;
    const std::vector<bus::TensorSource> sources = {
        {.name = "parameters", .shape = {parameter_rows, kCapacity}, .data = parameters.data()},
        {.name = "average", .shape = {41, kCapacity}, .data = parameters.data()},
        {.name = "normal", .shape = {3, kCapacity}, .data = normal.data()},
        {.name = "surface_point", .shape = {3, kCapacity}, .data = point.data()},
        {.name = "visibility", .shape = {kCapacity}, .data = ones.data()},
        {.name = "object_id", .shape = {kCapacity}, .type = bus::ElementType::U32, .data = object.data()},
        {.name = "flags", .shape = {kCapacity}, .type = bus::ElementType::U32, .data = flags.data()},
        {.name = "cell", .shape = {kCapacity}, .type = bus::ElementType::U64, .data = ids.data()},
        {.name = "gaussian_id", .shape = {kCapacity}, .type = bus::ElementType::U64, .data = ids.data()}};
    publisher_.publish(topics::kModelPublished, {.tensors = planes_.write(sources)}, [&](auto& builder, auto header) {
      return wire::CreateModelPublished(builder, header, generation, count, kCapacity);
    });
  }

  void publish_depth(std::uint64_t light_generation, float object_x, bool as_light = true) {
    Camera camera = look_at({0, 10, 0}, {0, 0, 0}, kTexels, kTexels, 1.0F);
    camera.role = as_light ? CameraRole::Light : CameraRole::Reference;
    camera.fx = camera.fy = kTexels / 6.0F;
    std::vector<float> depth(std::size_t{kTexels} * kTexels);
    for (std::uint32_t y = 0; y < kTexels; ++y) {
      for (std::uint32_t x = 0; x < kTexels; ++x) {
        const glm::vec3 floor = unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 10.0F);
        depth[std::size_t{y} * kTexels + x] = floor.x > 0 ? 5.0F : 10.0F;
      }
    }
    const bus::TensorSource source{.name = "light_depth", .shape = {kTexels, kTexels}, .data = depth.data()};
    const ObjectTransforms objects{{7, {.translation = {object_x, 0, 0}}}};
    publisher_.publish(
        topics::kSceneLightDepth, {.tensors = maps_.write({&source, 1})}, [&](auto& builder, auto header) {
          const Light light{.generation = light_generation};
          const auto light_offset = to_wire(builder, light);
          const auto wire_camera = to_wire(camera);
          const auto objects_offset = to_wire(builder, objects);
          return wire::CreateSceneLightDepth(builder, header, &wire_camera,
                                             wire::CreateSceneState(builder, 1, 0.0, objects_offset, light_offset));
        });
  }

  /// The next visibility of that model and light.
  std::vector<float> visibility(std::uint64_t model_generation, std::uint64_t light_generation) {
    std::vector<float> values;
    EXPECT_TRUE(bus_test::eventually([&] {
      const auto message = subscriber_.receive(5ms);
      if (!message) return false;
      const auto& relit = message->root<wire::RelightVisibility>();
      if (relit.model_generation() != model_generation || relit.light_generation() != light_generation) return false;
      const auto tensor = message->tensor("visibility", bus::ElementType::F32, {1, 0});
      values.resize(tensor.value().elements());
      return tensor->copy(values.data()) && values.size() == relit.count();
    }));
    return values;
  }

  bus::Parameters parameters_{bus::Parameters::declare<VisibilityOptions>()};
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  bus::TensorRing planes_, maps_;
  std::stop_source stop_;
  bus::ServiceContext service_;
  std::thread thread_;
};

}  // namespace splatbus::relight::test
