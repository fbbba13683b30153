#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "raster/rasterizer.h"
#include "sample_batch.h"
#include "trainer/model_slab.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// A floor of Gaussians, photographed by the rasterizer itself from cameras in a circle: what training must find again.
class SyntheticScene {
 public:
  /// Pictures of `size` x `size`.
  explicit SyntheticScene(std::size_t gaussians = 300, int cameras = 6, std::uint32_t size = 48)
      : truth_(sample_batch(1, 1, gaussians)), size_(size) {
    for (std::size_t i = 0; i < 3 * gaussians; ++i) truth_.log_scale[i] = std::log(i / gaussians == 1 ? 0.03F : 0.18F);
    scene_.light = truth_.light;
    scene_.light.background = glm::vec3(0.2F);
    std::vector<std::byte> memory(SlabLayout(ParameterLayout{}, rounded_capacity(gaussians)).bytes);
    const ModelPlanes planes(ParameterLayout{}, rounded_capacity(gaussians), memory.data());
    fill(planes);
    const auto rasterizer = raster::make_cpu_rasterizer(1);
    for (int c = 0; c < cameras; ++c) {
      const float angle = 2.0F * std::numbers::pi_v<float> * static_cast<float>(c) / static_cast<float>(cameras);
      TrainingView view;
      view.camera = look_at({3.5F * std::cos(angle), 2.5F, 3.5F * std::sin(angle)}, {0, 0, 0}, size, size, 1.0F);
      view.camera.id = static_cast<std::uint32_t>(c);
      view.scene = scene_;
      raster::Render render;
      rasterizer->render(planes.view(gaussians), view.camera, scene_, {.albedo = true, .depth = true}, render);
      view.color = Pixels<std::uint8_t>(to_rgba(render.color));
      view.albedo = Pixels<std::uint8_t>(to_rgba(render.albedo));
      std::vector<float> depth(std::size_t{size} * size);
      for (std::size_t i = 0; i < depth.size(); ++i) {
        depth[i] = render.alpha.data[i] > 0.5F ? render.depth.data[i] / render.alpha.data[i] : 0.0F;
      }
      view.depth = Pixels<float>(std::move(depth));
      views_.push_back(std::make_shared<const TrainingView>(std::move(view)));
    }
  }

  [[nodiscard]] const std::vector<TrainingViewPtr>& views() const { return views_; }
  [[nodiscard]] const SceneState& scene() const { return scene_; }
  [[nodiscard]] const InsertBatch& truth() const { return truth_; }

  /// The truth with means, scales and albedo astray.
  [[nodiscard]] InsertBatch perturbed() const {
    InsertBatch batch = truth_;
    std::mt19937 random(99);
    std::uniform_real_distribution<float> astray(-1.0F, 1.0F);
    for (float& value : batch.mean) value += 0.03F * astray(random);
    for (float& value : batch.log_scale) value += 0.2F * astray(random);
    for (float& value : batch.albedo) value = std::clamp(value + 0.25F * astray(random), 0.0F, 1.0F);
    return batch;
  }

  static std::vector<std::uint8_t> to_rgba(const raster::Image& image) {
    std::vector<std::uint8_t> rgba(std::size_t{image.width} * image.height * 4, 255);
    for (std::uint32_t c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < std::size_t{image.width} * image.height; ++i) {
        const float shown = srgb_from_linear(std::clamp(image.plane(c)[i], 0.0F, 1.0F));
        rgba[4 * i + c] = static_cast<std::uint8_t>(std::lround(255.0F * shown));
      }
    }
    return rgba;
  }

  /// Mean over all views, dB.
  [[nodiscard]] double psnr(const GaussiansView& gaussians) const {
    const auto rasterizer = raster::make_cpu_rasterizer(1);
    double square = 0;
    for (const auto& view : views_) {
      raster::Render render;
      rasterizer->render(gaussians, view->camera, view->scene, {}, render);
      const auto shown = to_rgba(render.color);
      for (std::size_t i = 0; i < shown.size(); ++i) square += std::pow(double(shown[i]) - double(view->color[i]), 2);
    }
    const double samples = 3.0 * size_ * size_ * static_cast<double>(views_.size());
    return 10.0 * std::log10(255.0 * 255.0 * samples / square);
  }

 private:
  void fill(const ModelPlanes& planes) const {
    const std::size_t n = truth_.count;
    const auto copy = [&](const std::vector<float>& from, float* to, int channel, std::size_t channels) {
      for (std::size_t c = 0; c < channels; ++c) {
        std::copy_n(from.data() + c * n, n, to + (static_cast<std::size_t>(channel) + c) * planes.capacity);
      }
    };
    copy(truth_.mean, planes.parameters, ParameterLayout::kMean, 3);
    copy(truth_.log_scale, planes.parameters, ParameterLayout::kLogScale, 3);
    copy(truth_.rotation, planes.parameters, ParameterLayout::kRotation, 4);
    copy(truth_.opacity_logit, planes.parameters, ParameterLayout::kOpacityLogit, 1);
    copy(truth_.albedo, planes.parameters, ParameterLayout::kAlbedo, 3);
    copy(truth_.normal, planes.normal, 0, 3);
    copy(truth_.visibility, planes.visibility, 0, 1);
  }

  InsertBatch truth_;
  std::uint32_t size_;
  SceneState scene_;
  std::vector<TrainingViewPtr> views_;
};

}  // namespace splatbus::trainer
