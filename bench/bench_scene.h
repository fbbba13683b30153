#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "bench/paged_scene.h"
#include "gaussians/model.h"
#include "raster/rasterizer.h"

namespace splatbus::bench {

struct Arguments {
  std::string scene, cameras, json, backend = "cpu", mode = "train", appearance = "radiance";
  int sh = 3, batch = 1, threads = 0, active_channels = 0;
  int iterations = 100, warmup = 20;
  bool separate_adam = false;
  std::string pages = "none";  ///< none; all: in pages, every one listed; seen: those that a camera sees
  int copies = 1;              ///< of the scene, of which the cameras see one
  std::size_t sources = 0;     ///< lights besides the sun, each with its row of visibility
  float albedo_weight = 0;     ///< CUDA, transfer: above 0 the pictures are albedo pictures, too
};

/// The model in the layout asked for, and what looks at it.
struct Workload {
  GaussiansBuffer model;
  std::vector<Camera> cameras;
  SceneState scene;
  PagedScene paged;
  std::vector<std::uint8_t> visibility;  ///< [1 + sources][count of view()]; empty without sources

  /// Throws std::runtime_error, naming the file.
  explicit Workload(const Arguments& arguments);
  [[nodiscard]] bool transfer() const { return model.layout().appearance == Appearance::Transfer; }
  /// Training starts from disturbed means and colours; the targets are the model's own pictures.
  void disturb();
  /// What is drawn and trained: the model, or the same Gaussians in pages.
  [[nodiscard]] GaussiansView view() const;
  [[nodiscard]] float* parameters();

 private:
  void add_sources(std::size_t count);

  std::string pages_;
};

/// A picture as u8 RGBA in display space.
[[nodiscard]] std::vector<std::uint8_t> to_target(const raster::Image& image, bool linear);
[[nodiscard]] double mean_of(const raster::Image& image);
[[nodiscard]] std::vector<float> learning_rates(const ParameterLayout& layout);
[[nodiscard]] double median(std::vector<double> values);
/// What every backend reports alike.
[[nodiscard]] nlohmann::json report(const Arguments& arguments, const Workload& workload,
                                    const std::vector<double>& milliseconds);

[[nodiscard]] nlohmann::json run_cpu(const Arguments& arguments);
[[nodiscard]] nlohmann::json run_cuda(const Arguments& arguments);

}  // namespace splatbus::bench
