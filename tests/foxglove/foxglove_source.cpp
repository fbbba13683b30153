// A service whose scene web/test/foxglove.test.mjs knows: one object, one camera with its picture, one viewer, a model.
#include <chrono>
#include <string>
#include <thread>
#include <vector>

#include "../unit/model/paged_publisher.h"
#include "../unit/stream/toy_model.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "gaussians/camera.h"
#include "wire/capture_generated.h"
#include "wire/convert.h"
#include "wire/engine_generated.h"
#include "wire/scene_generated.h"
#include "wire/viewer_generated.h"

namespace {

using namespace splatbus;

constexpr std::uint32_t kWidth = 64, kHeight = 48;

struct Options {
  double rate = 0.25;
  bool shown = true;
  std::string label = "7";
  void bind(bus::ParameterBinder& p) {
    p.add("rate", rate, "a number", {0, 1});
    p.add("shown", shown, "a switch");
    p.add("label", label, "a text that reads like a number");
  }
};

/// Left half red, right half blue.
std::vector<std::uint8_t> picture() {
  std::vector<std::uint8_t> rgba;
  for (std::uint32_t i = 0; i < kWidth * kHeight; ++i) {
    const bool left = i % kWidth < kWidth / 2;
    for (const int value : {left ? 220 : 30, 40, left ? 30 : 210, 255})
      rgba.push_back(static_cast<std::uint8_t>(value));
  }
  return rgba;
}

/// 2 m in the left half, and 0.25 m more in each row on the right.
std::vector<float> depths() {
  std::vector<float> metres;
  for (std::uint32_t i = 0; i < kWidth * kHeight; ++i) {
    metres.push_back(i % kWidth < kWidth / 2 ? 2.0F : 0.25F * static_cast<float>(i / kWidth));
  }
  return metres;
}

void run(bus::ServiceContext& service) {
  const bus::Publisher publisher(service.bus);
  model::PagedPublisher pages(service.bus);
  Camera camera = look_at({1, 2, 3}, {0, 0, 0}, kWidth, kHeight, 1);
  camera.id = 2;
  wire::Camera sent = to_wire(camera);
  SceneState scene{.version = 1};
  scene.objects[7] = Rigid{.rotation = glm::angleAxis(0.5F, glm::vec3(0, 1, 0)), .translation = {5, 6, 7}};

  pages.publish(publisher, stream::test::toy_model(3000, 1, 1, Appearance::Radiance), 1);
  publisher.publish(topics::kSceneState, [&](auto& builder, auto header) {
    return wire::CreateSceneUpdate(builder, header, to_wire(builder, scene));
  });
  // Two engines share the cameras: what one of them is asked for does not take the other's away.
  for (const char* engine : {"engine-1", "engine-2"}) {
    publisher.publish(topics::kEngineCameras, {.latch_key = engine}, [&](auto& builder, auto header) {
      const std::vector requests{wire::CreateCameraRequest(builder, &sent, wire::EngineBuffer::Color)};
      return wire::CreateEngineCamerasDirect(builder, header, &requests);
    });
    camera.id = 3;
    sent = to_wire(camera);
  }
  camera.id = 2;
  sent = to_wire(camera);
  const std::vector<std::uint8_t> rgba = picture();
  const std::vector<float> depth = depths();
  const bus::MessageInfo with_picture{
      .tensors = {
          {.name = "color", .shape = {kHeight, kWidth, 4}, .type = bus::ElementType::U8, .inline_data = rgba.data()},
          {.name = "depth", .shape = {kHeight, kWidth}, .type = bus::ElementType::F32, .inline_data = depth.data()}}};
  while (!service.stop.stop_requested()) {
    publisher.publish(topics::kCaptureReference, with_picture, [&](auto& builder, auto header) {
      return wire::CreateCaptureReference(builder, header, &sent, to_wire(builder, scene));
    });
    publisher.publish(topics::kViewerPose, [&](auto& builder, auto header) {
      return wire::CreateViewerPoseDirect(builder, header, "page", &sent);
    });
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
}

}  // namespace

int main(int argc, char** argv) {
  const bus::ServiceDescription description{
      .kind = "source", .summary = "A scene that a test knows", .parameters = bus::Parameters::declare<Options>()};
  return bus::service_main(argc, argv, description, run);
}
