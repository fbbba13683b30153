#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <set>

#include "bus/backend.h"
#include "bus/memory_pool.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "device/buffer.h"
#include "device/stream.h"
#include "model/published_model.h"
#include "relight/visibility.h"

namespace splatbus::relight {

struct RelightOptions {
  VisibilityOptions visibility;
  float newest_rate_hz = 10;  ///< at which visibility of the newest scene is computed where no picture asks for it

  void bind(bus::ParameterBinder& parameters);
};

/// The relight service: computes relight/visibility for every scene version that training pictures are of, and for the
/// newest one, and again when the model's structure changes.
class Relight {
 public:
  explicit Relight(bus::ServiceContext& service);

  /// Until `service.stop`.
  void run();

 private:
  /// The light-space depth of a scene version, in memory of our own.
  struct DepthMap {
    Camera camera;
    SceneState scene;
    std::shared_ptr<std::byte> depth_m;
    bool pictured = false;                             ///< a training picture of this version has come
    std::optional<std::uint64_t> computed_generation;  ///< of the model that its visibility was computed for
  };

  void take_depth(const wire::SceneLightDepth& depth, const bus::Message& message);
  void take_picture(std::uint64_t scene_version);
  void update();
  [[nodiscard]] bool is_due(const DepthMap& map, std::int64_t now_ns) const;
  /// False when the model has moved on meanwhile.
  bool compute(DepthMap& map, const PublishedModel& model);
  void publish(std::uint64_t model_generation, std::uint64_t scene_version, std::size_t count,
               const std::uint8_t* visibility);
  void report();

  bus::ServiceContext& service_;
  const Device memory_;
  const device::Stream stream_;
  bus::Publisher publisher_;
  bus::TensorRing ring_;
  bus::MemoryPool depths_;
  bus::LiveOptions<RelightOptions> options_;
  std::optional<bus::Message> model_;
  std::deque<DepthMap> maps_;               ///< by ascending version
  std::set<std::uint64_t> pictured_ahead_;  ///< versions whose picture came before their map
  device::Buffer<std::uint8_t> visibility_;
  std::atomic<std::uint64_t> host_copied_bytes_ = 0;  ///< bulk that came from, or went through, host memory
  std::uint64_t lost_tensors_ = 0, published_ = 0, unmapped_ = 0;
  std::int64_t newest_computed_ns_ = 0;
};

}  // namespace splatbus::relight
