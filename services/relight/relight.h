#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "bus/backend.h"
#include "bus/memory_pool.h"
#include "bus/publisher.h"
#include "bus/service.h"
#include "bus/subscriber.h"
#include "bus/tensor_ring.h"
#include "device/stream.h"
#include "model/published_model.h"
#include "relight/light_rows.h"
#include "relight/map_ring.h"
#include "relight/page_shares.h"
#include "relight/visibility.h"

namespace splatbus::relight {

struct RelightOptions {
  VisibilityOptions visibility;
  float newest_rate_hz = 10;  ///< at which visibility of the newest scene is computed where no picture asks for it

  void bind(bus::ParameterBinder& parameters);
};

/// The relight service: computes relight/visibility for every scene version that training pictures are of, and for the
/// newest one, and again when the model's structure changes. A version waits until all maps of all its lights that cast
/// shadows are there. Of several on a bus each computes the pages that are its own.
class Relight {
 public:
  explicit Relight(bus::ServiceContext& service);

  /// Until `service.stop`.
  void run();

 private:
  struct Version {
    SceneState scene;
    bool pictured = false;  ///< a training picture of this version has come
    std::vector<LightOfScene>
        lights;  ///< the sun, then the others by ascending id; empty until all their maps are there
    std::optional<std::uint64_t> computed_generation;  ///< of the model that its visibility was computed for
  };
  using Versions = std::map<std::uint64_t, Version>;

  void take_depth(const wire::SceneLightDepth& depth, const bus::Message& message);
  void take_scene(const wire::SceneState& scene, bool pictured);
  void take_model(const bus::Message& message);
  void update();
  /// Gives versions the maps that have come, and drops those whose maps will not come or that are of no use.
  void resolve();
  /// False while a map is missing.
  [[nodiscard]] bool find_maps(Version& version) const;
  [[nodiscard]] bool is_hopeless(const Version& version) const;
  void drop(Versions::iterator version);
  /// The newest whose maps are there; end() before there is one.
  [[nodiscard]] Versions::iterator newest();
  [[nodiscard]] bool is_due(const Version& version, std::int64_t now_ns);
  /// False when the model has moved on meanwhile.
  bool compute(Version& version, const PublishedModel& model);
  /// Of the pages in `mine` where several replicas share them.
  void publish(std::uint64_t model_generation, const SceneState& scene, const GaussiansView& mine,
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
  MapRing maps_;
  Versions versions_;
  PageShares shares_;
  std::int64_t begin_ns_ = 0;
  LightRows rows_;
  std::uint64_t model_epoch_ = 0;                     ///< of the trainer whose model rows_ are of
  std::atomic<std::uint64_t> host_copied_bytes_ = 0;  ///< bulk that came from, or went through, host memory
  std::uint64_t lost_tensors_ = 0, published_ = 0, unmapped_ = 0;
  std::int64_t newest_computed_ns_ = 0;
};

}  // namespace splatbus::relight
