#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "bus/backend.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "device/stream.h"
#include "relight/visibility.h"

namespace splatbus::relight {

/// The relight service: keeps relight/visibility in step with the model's structure, the light and the objects.
class Relight {
 public:
  explicit Relight(bus::ServiceContext& service);

  /// Until `service.stop`.
  void run();

 private:
  /// Memory of the backend's kind that is used again and again; contents are lost when it grows.
  struct Memory {
    std::shared_ptr<std::byte> bytes;
    std::size_t size = 0;
    [[nodiscard]] float* floats(std::size_t count, Device kind);
  };
  /// The newest light-space depth, in memory of our own, with the light and the transforms of its frame.
  struct DepthMap {
    Camera camera;
    std::uint64_t light_generation = 0;
    ObjectTransforms objects;
    Memory depth_m;
  };

  void take_depth(const wire::SceneLightDepth& depth, const bus::Message& message);
  void take_objects(const wire::SceneObjects& body);
  void update();
  void publish(std::uint64_t model_generation, std::size_t count, const float* visibility);
  void report();

  bus::ServiceContext& service_;
  const Device memory_;
  const device::Stream stream_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  bus::LiveOptions<VisibilityOptions> options_;
  std::optional<bus::Message> model_;
  std::optional<ObjectTransforms> objects_;
  std::optional<DepthMap> map_;
  Memory spare_depth_, visibility_;
  std::atomic<std::uint64_t> host_copied_bytes_ = 0;  ///< bulk that came from, or went through, host memory
  std::uint64_t computed_generation_ = 0, lost_tensors_ = 0, published_ = 0;
  bool scene_changed_ = false;
};

}  // namespace splatbus::relight
