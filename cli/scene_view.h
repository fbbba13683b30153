#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <optional>
#include <thread>
#include <vector>

#include "bus/subscriber.h"
#include "device/stream.h"
#include "gaussians/light.h"
#include "live_scene.h"
#include "relight/visibility.h"

namespace splatbus::cli {

/// Depth maps of scene/light_depth by their scene version, taken in on a thread of its own: the bridge writes the next
/// ones over them within a tenth of a second.
class LightDepths {
 public:
  explicit LightDepths(std::shared_ptr<bus::Context> context);

  struct Map {
    std::uint64_t version = 0;
    Camera camera;
    std::vector<float> depth_m;  ///< [height][width]
  };

  /// Whether maps are copied as they come; without it only the newest can be had. Copying each costs 100 MB/s and more.
  void keep(bool all);

  /// The map of a version; null when it has not come or has gone.
  [[nodiscard]] std::shared_ptr<const Map> find(std::uint64_t version);

 private:
  void receive(const std::stop_token& stop);
  static std::shared_ptr<const Map> copy(const bus::Message& message);

  std::shared_ptr<bus::Context> context_;
  std::mutex mutex_;
  bool keep_all_ = false;
  std::optional<bus::Message> newest_;
  std::deque<std::shared_ptr<const Map>> maps_;  ///< the newest last
  std::jthread thread_;
};

/// Renders the averaged model with the light, the transforms and the visibility of any scene version whose depth map is
/// there; the model's own visibility is that of the newest version. On the CPU. Not thread-safe.
class SceneView {
 public:
  explicit SceneView(int threads);

  /// CV_8UC3 BGR in display space; nullopt when there is no model, or its structure changed while it was drawn. Without
  /// `map` with the model's own visibility. `map` is of scene.version.
  [[nodiscard]] std::optional<cv::Mat> render(LiveScene& live, const Camera& camera, const SceneState& scene,
                                              const LightDepths::Map* map);

 private:
  device::Stream stream_{Device::Cpu};
  std::unique_ptr<raster::ModelRenderer> renderer_;
  raster::Render render_;
  std::vector<std::uint8_t> visibility_;
};

}  // namespace splatbus::cli
