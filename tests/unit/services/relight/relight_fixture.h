#pragma once

#include <functional>
#include <string>

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
        maps_(peer_, "maps", 64, 0, peers),
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
    // At x = -1, 1 and 0; means have drifted off the floor, which changes nothing.
    const auto stride = static_cast<std::ptrdiff_t>(model.stride());
    std::fill_n(model.parameters.begin(), 3 * stride, 0.0F);
    std::fill_n(model.parameters.begin() + stride, count, 0.02F);
    model.surface_point[0] = model.parameters[0] = -1.0F;
    model.surface_point[1] = model.parameters[1] = 1.0F;
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

  /// Object 7 at x, the sun's depth of that version, and `sources`.
  [[nodiscard]] SceneState scene(std::uint64_t version, float object_x) const {
    SceneState scene{.light = {.sun_irradiance = glm::vec3(1)}, .objects = {}, .version = version};
    scene.light.sun_depth_version = version;
    scene.light.sources = sources;
    scene.objects = {{7, Rigid{.translation = {object_x, 0, 0}}}};
    return scene;
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
    publish_map(scene(scene_version, object_x), 0, 0, 1, camera, depth);
  }

  /// Face of a point light at (0, 2, 0), on which everything is `depth_m` away.
  void publish_face(const SceneState& scene, std::uint32_t light_id, std::uint8_t face, float depth_m) {
    const glm::vec3 axis = face < 4 ? glm::vec3(0, 1, 0) : glm::vec3(1, 0, 0);
    const float angle = 1.5707964F * (face == 5 ? 3.0F : static_cast<float>(face) - (face == 4 ? 3.0F : 0.0F));
    Camera camera{.role = CameraRole::Light, .width = kTexels, .height = kTexels};
    camera.fx = camera.fy = camera.cx = camera.cy = kTexels / 2.0F;
    camera.world_from_camera = {.rotation = glm::angleAxis(angle, axis), .translation = {0, 2, 0}};
    publish_map(scene, light_id, face, 6, camera, std::vector<float>(std::size_t{kTexels} * kTexels, depth_m));
  }

  void publish_map(const SceneState& state, std::uint32_t light_id, std::uint8_t light_map, std::uint8_t light_maps,
                   const Camera& camera, const std::vector<float>& depth) {
    const bus::TensorSource source{.name = "light_depth", .shape = {kTexels, kTexels}, .data = depth.data()};
    const std::string key = std::to_string(light_id) + "/" + std::to_string(light_map);
    publisher_.publish(topics::kSceneLightDepth, {.latch_key = key, .tensors = maps_.write({&source, 1})},
                       [&](auto& builder, auto header) {
                         const auto wire_camera = to_wire(camera);
                         return wire::CreateSceneLightDepth(builder, header, &wire_camera, to_wire(builder, state),
                                                            light_id, light_map, light_maps);
                       });
  }

  void publish_scene(const SceneState& state) {
    publisher_.publish(topics::kSceneState, [&](auto& builder, auto header) {
      return wire::CreateSceneUpdate(builder, header, to_wire(builder, state));
    });
  }

  /// A training picture of that scene, of which only the announcement counts here.
  void publish_picture(const SceneState& state) {
    publisher_.publish(topics::kCaptureReference, [&](auto& builder, auto header) {
      const wire::Camera camera = to_wire(look_at({0, 1, 3}, {0, 0, 0}, 8, 8, 1.0F));
      return wire::CreateCaptureReference(builder, header, &camera, to_wire(builder, state), false);
    });
  }

  struct Relit {
    std::uint64_t scene_version = 0;
    std::vector<std::uint32_t> light_ids;
    std::vector<float> of_gaussian;              ///< 1 for all of the sun
    std::vector<std::vector<float>> of_sources;  ///< the same for each other light
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
      relit.light_ids.assign(body.light_ids()->begin(), body.light_ids()->end());
      const auto count = static_cast<std::uint32_t>(body.count());
      const auto tensor = message->tensor("visibility", bus::ElementType::U8, {body.light_ids()->size(), count});
      values.resize(tensor.value().elements());
      relit.scene_version = body.scene_version();
      return tensor->copy(values.data());
    }));
    for (std::size_t row = 0; row < relit.light_ids.size(); ++row) {
      std::vector<float> seen;
      const std::size_t first = row * (values.size() / relit.light_ids.size());
      for (const std::uint32_t index : index_) seen.push_back(static_cast<float>(values.at(first + index)) / 255);
      row == 0 ? relit.of_gaussian = std::move(seen) : relit.of_sources.emplace_back(std::move(seen));
    }
    return relit;
  }
  std::vector<float> visibility(std::uint64_t model_generation, std::uint64_t scene_version) {
    return next_visibility([&](const wire::RelightVisibility& body) {
             return body.model_generation() == model_generation && body.scene_version() == scene_version;
           })
        .of_gaussian;
  }

  std::vector<LightSource> sources;

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
