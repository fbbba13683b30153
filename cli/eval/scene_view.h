#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "bus/subscriber.h"
#include "device/stream.h"
#include "gaussians/light.h"
#include "live_scene.h"
#include "relight/light_rows.h"
#include "relight/map_ring.h"

namespace splatbus::cli {

/// The sun, then the other lights of a scene, each with its depth maps where it casts shadows.
using SceneLights = std::vector<relight::LightOfScene>;

/// The lights' depth maps of scene/light_depth, taken in on a thread of its own: the bridge writes the next ones over
/// them within a tenth of a second.
class LightDepths {
 public:
  explicit LightDepths(std::shared_ptr<bus::Context> context);

  /// Whether maps are copied as they come; without it only the newest can be had. Copying each costs 100 MB/s and more.
  void keep(bool all);

  /// The scene's lights with its very maps; nullopt while one has not come, and when one has gone.
  [[nodiscard]] std::optional<SceneLights> find(const SceneState& scene);

 private:
  void receive(const std::stop_token& stop);
  void copy(const bus::Message& message);

  std::shared_ptr<bus::Context> context_;
  std::mutex mutex_;
  bool keep_all_ = false;
  std::map<std::pair<std::uint32_t, std::uint32_t>, bus::Message> newest_;  ///< by light and map
  relight::MapRing maps_;
  std::jthread thread_;
};

/// Renders the averaged model with the light, the transforms and the visibility of any scene version whose depth maps
/// are there; the model's own visibility is that of the newest version. On the CPU. Not thread-safe.
class SceneView {
 public:
  explicit SceneView(int threads);

  /// CV_8UC3 BGR in display space; nullopt when there is no model, or its structure changed while it was drawn. Without
  /// `lights` with the model's own visibility. `lights` are the scene's.
  [[nodiscard]] std::optional<cv::Mat> render(LiveScene& live, const Camera& camera, const SceneState& scene,
                                              const SceneLights* lights);

 private:
  device::Stream stream_{Device::Cpu};
  std::unique_ptr<raster::ModelRenderer> renderer_;
  raster::Render render_;
  std::vector<std::uint8_t> visibility_;
};

}  // namespace splatbus::cli
