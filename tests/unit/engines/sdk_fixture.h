#pragma once

#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "../bus/bus_fixture.h"
#include "sdk/splatbus_engine.h"
#include "wire/engine_generated.h"
#include "wire/system_generated.h"

namespace splatbus::engine_test {

using bus_test::BusTest;
using bus_test::patience;

inline constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

struct Close {
  void operator()(splatbus_engine* engine) const { splatbus_engine_close(engine); }
};
using Engine = std::unique_ptr<splatbus_engine, Close>;

inline splatbus_camera small_camera(std::uint32_t id = 3, std::uint32_t role = SPLATBUS_ROLE_REFERENCE) {
  splatbus_camera camera{};
  camera.id = id;
  camera.role = role;
  camera.width = 8;
  camera.height = 6;
  camera.fx = camera.fy = 7;
  camera.cx = 4;
  camera.cy = 3;
  camera.near_m = 0.05F;
  camera.far_m = 100;
  camera.world_from_camera.rotation_wxyz[0] = 1;
  return camera;
}

/// A frame with a colour picture that owns its pixels.
struct OwnedFrame {
  explicit OwnedFrame(const splatbus_camera& camera)
      : color(std::size_t{4} * camera.width * camera.height, std::uint8_t{77}),
        images{{SPLATBUS_BUFFER_COLOR, color.data(), color.size(), SPLATBUS_MEMORY_HOST}} {
    frame.frame = 5;
    frame.time_s = 0.5;
    frame.camera = camera;
    frame.light.sun_direction[1] = 1;
    refresh();
  }
  void refresh() {
    frame.images = images.data();
    frame.image_count = images.size();
    frame.objects = objects.data();
    frame.object_count = objects.size();
  }
  std::vector<std::uint8_t> color;
  std::vector<splatbus_image> images;
  std::vector<splatbus_object> objects;
  splatbus_frame frame{};
};

struct Request {
  splatbus_camera camera;
  wire::EngineBuffer buffers = wire::EngineBuffer::Color;
  float rate_hz = 0;
  std::uint64_t id = 1;
  std::uint32_t light_id = 0;
  std::uint8_t light_map = 0;
  float extent_m = 0;
};

/// Of the engine of that name, or of all.
inline void publish_requests(const bus::Publisher& publisher, const std::vector<Request>& requests,
                             const std::string& engine = "") {
  publisher.publish(topics::kEngineCameras, {.latch_key = engine}, [&](auto& builder, auto header) {
    std::vector<flatbuffers::Offset<wire::CameraRequest>> offsets;
    for (const Request& request : requests) {
      const splatbus_camera& c = request.camera;
      const float* q = c.world_from_camera.rotation_wxyz;
      const float* t = c.world_from_camera.translation;
      const wire::Camera camera(c.id, static_cast<wire::CameraRole>(c.role), c.width, c.height, c.fx, c.fy, c.cx, c.cy,
                                c.near_m, c.far_m,
                                wire::Rigid(wire::Quat(q[0], q[1], q[2], q[3]), wire::Vec3(t[0], t[1], t[2])));
      offsets.push_back(wire::CreateCameraRequest(builder, &camera, request.buffers, request.rate_hz, request.id,
                                                  request.light_id, request.light_map, request.extent_m));
    }
    return wire::CreateEngineCamerasDirect(builder, header, &offsets);
  });
}

class SdkTest : public BusTest {
 protected:
  Engine open(const char* name = "engine", splatbus_memory memory = SPLATBUS_MEMORY_HOST) {
    splatbus_engine* engine = nullptr;
    EXPECT_EQ(splatbus_engine_open(directory_.address().text().c_str(), name, SPLATBUS_ENGINE_ABI, memory, &engine),
              SPLATBUS_OK)
        << splatbus_engine_last_error(nullptr);
    return Engine(engine);
  }

  /// Polls until the set of requests has changed.
  static std::vector<splatbus_camera_request> wait_for_change(splatbus_engine* engine) {
    const auto deadline = std::chrono::steady_clock::now() + patience;
    while (std::chrono::steady_clock::now() < deadline) {
      const splatbus_camera_request* requests = nullptr;
      std::size_t count = 0;
      int changed = 0;
      if (splatbus_engine_poll(engine, 100, &requests, &count, &changed) != SPLATBUS_OK) break;
      if (changed != 0) return {requests, requests + count};
    }
    ADD_FAILURE() << "the requests did not change";
    return {};
  }
};

}  // namespace splatbus::engine_test
