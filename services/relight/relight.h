#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "relight/visibility.h"

namespace splatbus::relight {

[[nodiscard]] std::vector<bus::ParameterSpec> parameter_specs();

/// The relight service: keeps relight/visibility in step with the model's structure, the light and the objects.
class Relight {
 public:
  explicit Relight(bus::ServiceContext& service);

  /// Until `service.stop`.
  void run();

 private:
  /// The newest light-space depth, in memory of our own, with the light and the transforms of its frame.
  struct DepthMap {
    Camera camera;
    std::uint64_t light_generation = 0;
    ObjectTransforms objects;
    std::vector<float> depth_m;
  };

  void handle(const bus::Message& message);
  void take_depth(const bus::Message& message);
  void update();
  void publish(std::uint64_t model_generation, std::size_t count);
  [[nodiscard]] VisibilityOptions options() const;

  bus::ServiceContext& service_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  std::optional<bus::Message> model_;
  std::optional<ObjectTransforms> objects_;
  std::optional<DepthMap> map_;
  std::vector<float> visibility_;
  std::uint64_t computed_generation_ = 0, parameters_version_ = 0, lost_tensors_ = 0, published_ = 0;
  bool scene_changed_ = false;
};

}  // namespace splatbus::relight
