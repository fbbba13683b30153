#pragma once

#include <functional>

#include "../../bus/bus_fixture.h"
#include "../../model/paged_publisher.h"
#include "bus/tensor_ring.h"
#include "relight/relight.h"
#include "wire/capture_generated.h"
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

  explicit RelightTest(Device backend = Device::Cpu, Device peers = Device::Cpu)
      : peer_(connect("peer")),
        subscriber_(peer_, {"relight/visibility"}),
        publisher_(peer_),
        pages_(peer_, peers),
        maps_(peer_, "maps", 8, 0, peers),
        service_(connect("relight"), parameters_, stop_.get_token(), backend),
        thread_([this] { Relight(service_).run(); }) {}

  ~RelightTest() override {
    stop_.request_stop();
    thread_.join();
  }

  /// Two Gaussians on the floor, at x = -1 and x = 1, and a third one of object 7 at its origin.
  void publish_model(std::uint64_t generation, std::size_t count = 3) {
    GaussiansBuffer model(ParameterLayout{}, count);
    std::fill(model.parameters.begin(), model.parameters.end(), -4.0F);
    std::fill_n(model.normal.begin() + static_cast<std::ptrdiff_t>(model.stride()), count, 1.0F);
    model.surface_point[0] = -1.0F;
    model.surface_point[1] = 1.0F;
    if (count > 2) model.object_id[2] = 7;
    index_ = pages_.publish(publisher_, model, generation);
  }

  /// Of pages that nobody has.
  void publish_lie(std::uint64_t generation, std::uint32_t page_lanes = kPageLanes) {
    publisher_.publish(topics::kModelPublished, [&](auto& builder, auto header) {
      return wire::CreateModelPublished(builder, header, generation, 3, 1, 1, 1, page_lanes,
                                        model::page_words(ParameterLayout{}));
    });
  }

  void publish_depth(std::uint64_t scene_version, float object_x, bool as_light = true, float roof_from_x = 0) {
    Camera camera = look_at({0, 10, 0}, {0, 0, 0}, kTexels, kTexels, 1.0F);
    camera.role = as_light ? CameraRole::Light : CameraRole::Reference;
    camera.fx = camera.fy = kTexels / (roof_from_x == 0 ? 6.0F : 6.5F);
    std::vector<float> depth(std::size_t{kTexels} * kTexels);
    for (std::uint32_t y = 0; y < kTexels; ++y) {
      for (std::uint32_t x = 0; x < kTexels; ++x) {
        const glm::vec3 floor = unproject(camera, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F, 10.0F);
        depth[std::size_t{y} * kTexels + x] = floor.x > roof_from_x ? 5.0F : 10.0F;
      }
    }
    const bus::TensorSource source{.name = "light_depth", .shape = {kTexels, kTexels}, .data = depth.data()};
    const ObjectTransforms objects{{7, {.translation = {object_x, 0, 0}}}};
    publisher_.publish(
        topics::kSceneLightDepth, {.tensors = maps_.write({&source, 1})}, [&](auto& builder, auto header) {
          const auto wire_camera = to_wire(camera);
          const auto scene = to_wire(builder, SceneState{.light = {}, .objects = objects, .version = scene_version});
          return wire::CreateSceneLightDepth(builder, header, &wire_camera, scene);
        });
  }

  /// A training picture of that version, of which only the announcement counts here.
  void publish_picture(std::uint64_t scene_version) {
    publisher_.publish(topics::kCaptureReference, [&](auto& builder, auto header) {
      const wire::Camera camera = to_wire(look_at({0, 1, 3}, {0, 0, 0}, 8, 8, 1.0F));
      const auto scene = to_wire(builder, SceneState{.light = {}, .objects = {}, .version = scene_version});
      return wire::CreateCaptureReference(builder, header, &camera, scene, false);
    });
  }

  struct Relit {
    std::uint64_t scene_version = 0;
    std::vector<float> of_gaussian;  ///< 1 for all of the sun
  };
  /// The next visibility, for which `accept` is true.
  Relit next_visibility(const std::function<bool(const wire::RelightVisibility&)>& accept = [](const auto&) {
    return true;
  }) {
    std::vector<std::uint8_t> values;
    Relit relit;
    EXPECT_TRUE(bus_test::eventually([&] {
      const auto message = subscriber_.receive(5ms);
      if (!message) return false;
      const auto& body = message->root<wire::RelightVisibility>();
      if (!accept(body)) return false;
      const auto tensor = message->tensor("visibility", bus::ElementType::U8, {1, 0});
      values.resize(tensor.value().elements());
      relit.scene_version = body.scene_version();
      return tensor->copy(values.data()) && values.size() == body.count();
    }));
    for (const std::uint32_t index : index_) {
      relit.of_gaussian.push_back(static_cast<float>(values.at(index)) / 255);
    }
    return relit;
  }
  std::vector<float> visibility(std::uint64_t model_generation, std::uint64_t scene_version) {
    return next_visibility([&](const wire::RelightVisibility& body) {
             return body.model_generation() == model_generation && body.scene_version() == scene_version;
           })
        .of_gaussian;
  }

  bus::Parameters parameters_{bus::Parameters::declare<RelightOptions>()};
  std::shared_ptr<bus::Context> peer_;
  bus::Subscriber subscriber_;
  bus::Publisher publisher_;
  model::PagedPublisher pages_;
  std::vector<std::uint32_t> index_;  ///< of each Gaussian
  bus::TensorRing maps_;
  std::stop_source stop_;
  bus::ServiceContext service_;
  std::thread thread_;
};

}  // namespace splatbus::relight::test
