#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <opencv2/core.hpp>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "device/stream.h"
#include "raster/model_renderer.h"
#include "stream/display_gaussians.h"
#include "stream/visibility_history.h"
#include "stream_figures.h"
#include "viewer/stream_client.h"

namespace splatbus::cli {

/// A viewer in this process: the viewer's own client on a thread, its own renderer on the caller's. It asks for no
/// probe pictures, which would travel over the link that is measured: whoever has one on the bus draws it here.
class LinkedViewer {
 public:
  /// Throws bus::Error as StreamClient.
  LinkedViewer(const std::string& endpoint, const std::string& name);
  ~LinkedViewer();
  LinkedViewer(const LinkedViewer&) = delete;
  LinkedViewer& operator=(const LinkedViewer&) = delete;

  void look(const Camera& camera);

  struct Status {
    std::int64_t begun_ns = 0;
    std::int64_t first_ns = 0;  ///< CLOCK_MONOTONIC when there was a Gaussian to show; 0 before
    std::int64_t whole_ns = 0;  ///< when all pages that there were had come; 0 before
    bool whole = false;         ///< now
    std::size_t gaussians = 0;
    double tick_hz = 0;                    ///< of the streamer; 0 before it has said so
    std::uint64_t refused = 0;             ///< packets that were wrong
    std::uint64_t visibility_version = 0;  ///< newest scene version that any Gaussian's visibility is of
  };
  [[nodiscard]] Status status() const;
  /// What has come so far.
  [[nodiscard]] std::vector<Arrival> arrivals() const;
  [[nodiscard]] std::vector<Delivery> deliveries() const;

  /// What is held, with the visibility nearest to the scene's version. CV_8UC3 BGR; nullopt while there is no Gaussian.
  /// Throws what has ended the thread.
  [[nodiscard]] std::optional<cv::Mat> draw(const Camera& camera, const SceneState& scene);

 private:
  void run(const std::stop_token& stop);

  viewer::StreamClient client_;         // the thread's own
  std::vector<Arrival> taken_;          // too
  std::vector<Delivery> delivered_;     // too
  double tick_hz_ = 0;                  // too
  device::Stream stream_{Device::Cpu};  // the caller's
  stream::DisplayGaussians display_;    // too
  std::unique_ptr<raster::ModelRenderer> renderer_;
  raster::Render render_;

  mutable std::mutex mutex_;  // of all below
  std::optional<Camera> camera_;
  stream::DisplayChanges changes_;
  stream::VisibilityHistory visibility_;  ///< of all that came, changes_ included
  Status status_;
  std::vector<Arrival> arrivals_;
  std::vector<Delivery> deliveries_;
  std::exception_ptr failure_;

  std::jthread thread_;  // last: it uses all of it
};

}  // namespace splatbus::cli
